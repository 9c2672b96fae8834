"""A tiny dataset of every command that makes one, without a simulator. Made once, not to be written to."""

from __future__ import annotations

from collections.abc import Mapping
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


def make_every_dataset(folder: Path) -> Mapping[str, Path]:
    """Returns what made a dataset -> its folder."""
    made = {**_collected(folder), **_recorded(folder)}
    pictured, bare, other = made["collect"], made["collect --no-images"], made["collect, other seed"]
    made["render"] = folder / "rendered"
    add_pictures(bare, made["render"], make_sound_env)
    rows = ConvertOptions(rows=RowOptions(num_points=POINTS))
    for name, sources in (
        ("keyframes", [made[RECORDING]]),
        ("keyframes of a roll-out", [made[ROLLOUT]]),
        ("keyframes, mixed with collect", [made[RECORDING], pictured]),
    ):
        made[name] = folder / name.replace(" ", "-").replace(",", "")
        convert(sources, made[name], rows)
    made.update(
        {
            "merge": run("merge", pictured, other, "--out", folder / "merged"),
            "merge of corrections": run("merge", bare, made["collect --policy"], "--out", folder / "with-corrections"),
            "filter": run("filter", pictured, "--where", "failed_tries>=1", "--out", folder / "filtered"),
            "filter of a mix": run(
                "filter", made["keyframes, mixed with collect"], "--where", "success=true", "--out", folder / "success"
            ),
            "split": run("split", other, "--parts", "train=0.5,test=0.5", "--out", folder / "parts") / "train",
        }
    )
    return made


def run(command: str, *words: object) -> Path:
    """Runs an `adamanip` command that has to succeed; returns its last word, a folder."""
    assert main([command, *map(str, words)]) == 0
    return Path(str(words[-1]))


def _collected(folder: Path) -> dict[str, Path]:
    categories = {"objects": ("safe_000", "door_001"), "episodes_per_object": 2}
    corrected = make_spec(
        num_points=POINTS, image_size=PIXELS, policy=POLICY, expert_share=0.4, observe_images=False, seed=5000
    )
    made = {
        "collect": collect_sound(folder / "collected", keep_failed=True, episodes_per_object=4),
        "collect, other seed": collect_sound(folder / "other", seed=1000),
        "collect --no-images": collect_sound(folder / "bare", observe_images=False),
        "collect of several categories": collect_sound(folder / "categories", **categories),
        "collect --policy": folder / "corrected",
    }
    factories = Factories(make_sound_env, demos_fake_env.make_expert, demos_fake_env.FakeActor)
    collect(made["collect --policy"], corrected, factories, patiently())
    return {**made, "collect --keep-failed": folder / "collected-failed"}


def _recorded(folder: Path) -> dict[str, Path]:
    recording = write_recording(folder / "recording", dense_episode(seed=1), dense_episode(seed=2, opens=False))
    return {
        RECORDING: recording,
        ROLLOUT: write_recording(folder / "rollout", _taken_over(3), _taken_over(4)),
        TICKS_ALONE: _ticks_alone(folder / "ticks"),
    }


def _taken_over(seed: int) -> DenseEpisode:
    """An episode of a roll-out that somebody takes over."""
    episode = dense_episode(seed=seed)
    begin = int(np.flatnonzero((episode.sent == STOPS[2].goal).all(axis=1))[0]) + 6
    return replace(episode, corrected=np.arange(len(episode)) >= begin)


def _ticks_alone(root: Path) -> Path:
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
    return root
