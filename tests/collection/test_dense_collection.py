"""Collections at control rate: the same bytes however they are made, and replayed, rendered and cut to key frames."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import demos_fake_env
import numpy as np
import pytest
from demos_helpers import patiently, same_bytes
from dense_episodes import DENSE_FAKES, FULL, collect_dense, dense_spec, make_dense_env

from lerobot_adamanip.cli.main import main, parse_command
from lerobot_adamanip.collection.collect import collect
from lerobot_adamanip.collection.key_frames import key_frame_columns, write_key_frames
from lerobot_adamanip.collection.partial import Part
from lerobot_adamanip.collection.record import Factories
from lerobot_adamanip.collection.render import add_pictures
from lerobot_adamanip.collection.replay import replay
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import ACTION_NAMES
from lerobot_adamanip.contract.keyframes import Goal, KeyFrameLabels, Phase
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.datasets.cards import collect_command
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.check.features import OF_LEROBOT
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, columns_of
from lerobot_adamanip.datasets.dataset import Dataset, open_dataset
from lerobot_adamanip.datasets.manifest import Manifest
from lerobot_adamanip.datasets.pose_statistics import leave_poses_unscaled
from lerobot_adamanip.datasets.stats import read_stats
from lerobot_adamanip.datasets.view import read_episode
from lerobot_adamanip.episode.dense import DenseRecorder, DenseStep, dense_rollout
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.video import open_mp4
from lerobot_env_adamanip import make_environment as factory


@pytest.fixture
def whole(tmp_path: Path, in_process: None) -> Path:
    return collect_dense(tmp_path / "whole" / "demos", keep_failed=True)


def test_an_interrupted_collection_goes_on_to_the_same_bytes(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root, written = tmp_path / "demos", []

    def interrupt(name: str) -> None:
        if name == "shard in place":
            written.append(name)
            if len(written) in (2, 3):
                raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(files, "on_crash_point", interrupt)
        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                collect_dense(root, keep_failed=True)
    assert not root.exists()
    same_bytes(whole, collect_dense(root, keep_failed=True))


def test_no_step_follows_the_end_of_an_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time ends in the middle of a motion."""
    env, steps = make_dense_env(dense_spec().environment_of("safe")), list[Any]()
    observation, _ = env.reset(seed=0, options={"object_id": "safe_000"})
    step = env.step

    def last_step(action: np.ndarray) -> tuple[Any, ...]:
        steps.append(action)
        following, reward, terminated, _, info = step(action)
        return following, reward, terminated, True, info

    monkeypatch.setattr(env, "step", last_step)
    far: Any = (goal for goal in [Goal(transform((0.3, 0.0, 0.9)), 1.0, Phase.APPROACH)])
    result = dense_rollout(cast("Any", env), observation, far)
    assert (len(steps), result.key_frames, result.success) == (1, 1, False)


def test_parts_make_the_same_bytes(whole: Path, tmp_path: Path) -> None:
    spec, root = dense_spec(keep_failed=True), tmp_path / "demos"
    parts = [tmp_path / name for name in ("one", "two")]
    for number, part in enumerate(parts, start=1):
        collect(part, spec, DENSE_FAKES, patiently(part=Part(number, 2)))
    collect(root, spec, DENSE_FAKES, patiently(adopt=tuple(parts)))
    same_bytes(whole, root)


def test_workers_make_the_same_bytes(tmp_path: Path) -> None:
    roots = [tmp_path / name / "demos" for name in ("one", "two")]
    for count, root in enumerate(roots, start=1):
        collect(root, dense_spec(), DENSE_FAKES, patiently(workers=count))
    same_bytes(*roots)


def test_failed_episodes_are_kept_apart_and_sound(whole: Path) -> None:
    failed = CollectionPaths(whole).failed
    assert check(failed).findings == []
    assert not any(episode.row["success"] for episode in Dataset(failed).episodes)


def test_columns_are_those_of_the_options(whole: Path) -> None:
    features = Dataset(whole).features
    expected = columns_of(dense_spec().environment)
    assert {key: tuple(features[key]["shape"]) for key in expected} == {
        key: tuple(feature["shape"]) for key, feature in expected.items()
    }


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("action", ACTION_NAMES)
def test_a_replay_is_the_same_and_its_video_runs_at_the_datasets_rate(action: str, tmp_path: Path) -> None:
    root, video = collect_dense(tmp_path / "demos", action=action, fps=5), tmp_path / "replay.mp4"
    for number in range(4):
        result = replay(root, number, make_dense_env, video=video)
        assert result.agrees(0.0)
        assert (result.unit, result.key_frames) == ("steps", Dataset(root).episode(number).length - 1)
    with open_mp4(video) as container:
        assert container.streams.video[0].average_rate == 5


@pytest.mark.usefixtures("in_process")
def test_pictures_added_later_are_those_of_a_collection_with_pictures(whole: Path, tmp_path: Path) -> None:
    plain = collect_dense(tmp_path / "plain", observe_images=False)
    assert add_pictures(plain, tmp_path / "pictured", make_dense_env) == 4
    assert check(tmp_path / "pictured").findings == []
    rows = [open_dataset(root, video_backend="pyav", return_uint8=True) for root in (whole, tmp_path / "pictured")]
    for one, other in zip(*rows, strict=True):
        for key in (key for key in one if key.startswith("observation.images.")):
            np.testing.assert_array_equal(one[key], other[key])


FRONT: dict[str, Any] = {"cameras": ("front",), "image_source": "render"}


@pytest.mark.parametrize(
    ("control", "changes"),
    [("dense", {}), ("dense", {"action": "joint", "fps": 25}), ("dense", FULL), ("dense", FRONT), ("keyframe", FRONT)],
    ids=["defaults", "joint", "full", "cameras", "key frames"],
)
def test_a_command_parses_back(control: str, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot_env_adamanip.sim import render_device

    monkeypatch.setattr(render_device, "can_render", lambda: True)
    chosen = changes if control == "dense" else {key: changes[key] for key in changes if key in ("cameras",)}
    spec = dense_spec(control=control, image_size=128, **chosen)
    parsed = parse_command("collect", collect_command(spec, "demos").split()[2:]).spec()
    assert Manifest(parsed).to_json() == Manifest(spec).to_json()


# Key frames -----------------------------------------------------------------------------------------------------------

SEEN: list[tuple[np.ndarray, Any]] = []


def spied_expert(*positional: Any, **named: Any) -> Iterator[Any]:
    """The fake expert; notes each goal and how it ended."""
    expert = demos_fake_env.make_expert(*positional, **named)
    goal = next(expert, None)
    while goal is not None:
        feedback = yield goal
        SEEN.append((goal.action(), feedback.outcome))
        try:
            goal = expert.send(feedback)
        except StopIteration:
            return


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("images", [True, False])
def test_key_frames_are_the_experts(images: bool, tmp_path: Path) -> None:
    SEEN.clear()
    spec = dense_spec(late_starts=0.0, **FULL)
    collect(tmp_path / "dense", spec, Factories(make_dense_env, spied_expert), patiently())
    leave_poses_unscaled(tmp_path / "dense")
    episodes, count = write_key_frames(tmp_path / "dense", tmp_path / "frames", images=images)
    assert json.loads((tmp_path / "frames" / "meta" / "stats.json").read_text())["action"]["std"][3:] == [1.0] * 7
    assert check(tmp_path / "frames").findings == []
    dense, frames = Dataset(tmp_path / "dense"), Dataset(tmp_path / "frames")
    environment = spec.environment.changed(control="keyframe", observe_images=images)
    assert {*frames.features} == {*columns_of(environment), *OF_LEROBOT}
    assert (len(frames), frames.info["total_frames"]) == (episodes, count + episodes)
    seen = [(goal.tolist(), int(outcome)) for goal, outcome in SEEN]
    for number in range(len(frames)):
        rows, before = frames.columns(frames.episode(number)), dense.columns(dense.episode(number))
        pairs = list(zip(rows[schema.ACTION][:-1].tolist(), rows[schema.OUTCOME][:-1].tolist(), strict=True))
        assert any(seen[start : start + len(pairs)] == pairs for start in range(len(seen)))
        np.testing.assert_array_equal(rows[schema.STATE][0], before[schema.STATE][0])
        np.testing.assert_array_equal(rows[schema.STATE][-1], before[schema.STATE][-1])
        failed = [bool(fails) for _, _, fails in frames.descriptions()[number].episode_record["try_sequence"]]
        assert rows[schema.FAILED].sum() == sum(failed) == rows[schema.TRIAL][-1]
    assert read_stats(tmp_path / "frames").lengths == read_stats(tmp_path / "dense").lengths


def test_a_try_that_starts_after_the_success_has_no_label() -> None:
    """The record ends with the success, but the expert continues and may touch another joint."""
    tries = [[1, 1, True], [0, 1, False]]
    env = SimpleNamespace(joints=lambda: np.zeros(2), episode_record=lambda: {"try_sequence": tries})
    labels = [KeyFrameLabels(joint, number=number) for number, joint in enumerate((1, 0, 1))]
    goal = Goal(np.eye(4), 0.0, Phase.TRY)
    steps = [DenseStep({}, np.zeros(7, np.float32), goal, None, {}, each.number > 0, each) for each in labels]
    columns = DenseRecorder(cast(Any, env), steps)._tries()
    assert columns[schema.TRIED] == [1, 0, -1, -1]
    assert columns[schema.FAILED] == [True, False, False, False]


def test_key_frames_need_clouds_effort_and_the_full_state(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="--control dense --cloud --effort --state full"):
        write_key_frames(whole, tmp_path / "frames")
    assert not list(tmp_path.glob("frames*"))


def test_a_dataset_whose_actions_were_not_sent_has_no_key_frames() -> None:
    columns = {schema.ACTION: np.zeros((3, 10)), schema.EXECUTED: np.eye(3, 10)}
    with pytest.raises(DatasetError, match="has no key frames: something else than its actions was sent"):
        key_frame_columns(columns, 10)


# Commands -------------------------------------------------------------------------------------------------------------


def test_every_command_takes_it(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(factory, "make_environment", make_dense_env)
    out = {name: str(tmp_path / name) for name in ("view.png", "some", "parts", "again", "replay.mp4")}
    for words in (
        ["check", str(whole), "--replay", "2"],
        ["stats", str(whole)],
        ["view", str(whole), "--out", out["view.png"]],
        ["filter", str(whole), "--where", "key_frames>=2", "--where", "length>3", "--out", out["some"]],
        ["split", str(whole), "--parts", "a=0.5,b=0.5", "--out", out["parts"]],
        ["merge", f"{out['parts']}/a", f"{out['parts']}/b", "--out", out["again"]],
        ["check", out["again"]],
        ["replay", str(whole), "--out", out["replay.mp4"]],
        ["push", "dataset", str(whole), "--repo-id", "someone/demos", "--dry-run"],
    ):
        assert main(words) == 0, (words, capsys.readouterr())
    printed = capsys.readouterr().out
    assert "Steps of an episode, at 10 Hz" in printed
    assert "  steps       " in printed
    assert "--env.control=dense --env.fps=10 --env.action=ee_delta --env.state=pose" in printed


def test_counts_and_pictures_are_of_tries_not_of_rows(whole: Path) -> None:
    stats, dataset = read_stats(whole), Dataset(whole)
    records = [description.episode_record["try_sequence"] for description in dataset.descriptions()]
    shown = [read_episode(whole, number) for number in range(len(dataset))]
    assert stats.overall.tries == sum(map(len, records)) == sum(len(each.tries) for each in shown)
    assert [[each.failed for each in episode.tries] for episode in shown] == [
        [fails for _, _, fails in record] for record in records
    ]
    assert all(dataclasses.asdict(each)["unit"] == "step" and not each.clouds.size for each in shown)
