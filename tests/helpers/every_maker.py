"""A tiny dataset of every command that makes one, without a simulator. Not to be written to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import demos_fake_env
import numpy as np
from demos_helpers import make_spec, patiently
from dense_helpers import STOPS, dense_episode, dense_features, frames, write_recording
from sound_demos import PIXELS, POINTS, collect_sound, make_sound_env

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.record import Factories
from lerobot_adamanip.collection.render import add_pictures
from lerobot_adamanip.contract.schema import ACTION, STATE
from lerobot_adamanip.hardware.features import recorded_features
from lerobot_adamanip.recordings.convert import ConvertOptions, convert
from lerobot_adamanip.recordings.keyframe_choice import DenseEpisode
from lerobot_adamanip.recordings.rows import RowOptions

POLICY = "0123456789abcdef" * 2
TICKS_ALONE, RECORDING, ROLLOUT = "lerobot-record without a camera", "lerobot-record", "lerobot-rollout"
DENSE = (TICKS_ALONE, RECORDING, ROLLOUT)
"""Recordings of ticks, not of key frames. The twin's have the columns of `lerobot-record`."""
OPTIONS = ConvertOptions(rows=RowOptions(num_points=POINTS))


class EveryDataset(dict[str, Path]):
    """What makes a dataset -> its folder. Each is made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        mix = "keyframes, mixed with collect"
        self.makers: dict[str, Callable[[Path], object]] = {
            "collect": lambda out: collect_sound(out, keep_failed=True, episodes_per_object=4),
            "collect, other seed": lambda out: collect_sound(out, seed=1000),
            "collect --no-images": lambda out: collect_sound(out, observe_images=False),
            "collect of several categories": lambda out: collect_sound(
                out, objects=("safe_000", "door_001"), episodes_per_object=2
            ),
            "collect --policy": _corrected,
            "render": lambda out: add_pictures(self["collect --no-images"], out, make_sound_env),
            RECORDING: lambda out: write_recording(out, dense_episode(seed=1), dense_episode(seed=2, opens=False)),
            ROLLOUT: lambda out: write_recording(out, _taken_over(3), _taken_over(4)),
            TICKS_ALONE: _ticks_alone,
            "keyframes": lambda out: convert([self[RECORDING]], out, OPTIONS),
            "keyframes of a roll-out": lambda out: convert([self[ROLLOUT]], out, OPTIONS),
            mix: lambda out: convert([self[RECORDING], self["collect"]], out, OPTIONS),
            "merge": lambda out: run("merge", self["collect"], self["collect, other seed"], "--out", out),
            "merge of corrections": lambda out: run(
                "merge", self["collect --no-images"], self["collect --policy"], "--out", out
            ),
            "filter": lambda out: run("filter", self["collect"], "--where", "failed_tries>=1", "--out", out),
            "filter of a mix": lambda out: run("filter", self[mix], "--where", "success=true", "--out", out),
        }

    def __missing__(self, name: str) -> Path:
        out = self.folder / "".join(letter if letter.isalnum() else "-" for letter in name)
        if name == "collect --keep-failed":
            self[name] = self["collect"].with_name(f"{self['collect'].name}-failed")
        elif name == "split":
            run("split", self["collect, other seed"], "--parts", "train=0.5,test=0.5", "--out", out)
            self[name] = out / "train"
        else:
            self.makers[name](out)
            self[name] = out
        return self[name]


def run(command: str, *words: object) -> None:
    """Runs an `adamanip` command that has to succeed."""
    assert main([command, *map(str, words)]) == 0


def _corrected(out: Path) -> None:
    spec = make_spec(
        num_points=POINTS, image_size=PIXELS, policy=POLICY, expert_share=0.4, observe_images=False, seed=5000
    )
    factories = Factories(make_sound_env, demos_fake_env.make_expert, demos_fake_env.FakeActor)
    collect(out, spec, factories, patiently())


def _taken_over(seed: int) -> DenseEpisode:
    """An episode of a roll-out that somebody takes over."""
    episode = dense_episode(seed=seed)
    begin = int(np.flatnonzero((episode.sent == STOPS[2].goal).all(axis=1))[0]) + 6
    return replace(episode, corrected=np.arange(len(episode)) >= begin)


def _ticks_alone(root: Path) -> None:
    """As `lerobot-record` writes it without a camera."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = recorded_features({key: feature for key, feature in dense_features().items() if key in (STATE, ACTION)})
    dataset = LeRobotDataset.create("local/ticks", 50, features, root=root, robot_type="adamanip_franka")
    for seed in (5, 6):
        episode = dense_episode(seed=seed)
        for frame in frames(episode, features):
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()
