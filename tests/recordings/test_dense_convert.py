"""Dense recordings become demonstrations: the columns, the description and the checks of simulated ones."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dense_helpers import FPS, STOPS, Stop, calibration, dense_episode, depth_at, write_recording

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.datasets.check.dataset import check
from lerobot_adamanip.datasets.dataset import Dataset, camera_of, open_dataset
from lerobot_adamanip.datasets.editing import merge
from lerobot_adamanip.datasets.opening import read_info
from lerobot_adamanip.datasets.repair import repair
from lerobot_adamanip.hardware.camera_frames import save_calibration
from lerobot_adamanip.hardware.features import CALIBRATIONS, SAFETY
from lerobot_adamanip.hardware.robot_registry import ROBOTS
from lerobot_adamanip.hardware.safety import SafetyLimits, accepted, limits_from_json
from lerobot_adamanip.lerobot_patches.durable_recording import _keep_robot
from lerobot_adamanip.recordings.convert import ConvertOptions, convert
from lerobot_adamanip.recordings.keyframe_choice import choose_key_frames
from lerobot_adamanip.recordings.recording import DenseRecording
from lerobot_adamanip.recordings.rows import RowOptions, demonstration_columns
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

POINTS = 64
OPTIONS = ConvertOptions(rows=RowOptions(num_points=POINTS))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes. Not to be written to."""
    root = tmp_path_factory.mktemp("dense") / "recording"
    return write_recording(root, dense_episode(seed=1), dense_episode(seed=2, opens=False))


@pytest.fixture(scope="module")
def converted(recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("converted") / "demonstrations"
    made = convert([recording], out, OPTIONS)
    assert (made.episodes, made.key_frames, made.simulated, made.skipped) == (2, 2 * (len(STOPS) - 1), 0, ())
    return out


def rows_of(root: Path) -> list[dict[str, Any]]:
    dataset = open_dataset(root, video_backend="pyav")
    return [dataset[index] for index in range(len(dataset))]


def test_converted_demonstrations_pass_the_check(converted: Path) -> None:
    assert check(converted).findings == []


def test_every_action_is_an_accepted_target(recording: Path, converted: Path) -> None:
    rows, number = rows_of(converted), 0
    for opens in (True, False):
        for stop in STOPS[1:]:
            np.testing.assert_array_equal(rows[number][schema.ACTION], stop.goal)
            np.testing.assert_array_equal(rows[number][schema.EXECUTED], stop.goal)
            assert not rows[number][schema.DONE]
            number += 1
        assert rows[number][schema.DONE]
        assert bool(rows[number][schema.SUCCESS]) is opens
        number += 1
    ticks = [json.loads(text)["ticks"] for text in Dataset(converted).table["recorded"].to_pylist()]
    assert number == len(rows) == sum(map(len, ticks))


def require_true_rows(converted: Path, cameras: Sequence[int]) -> None:
    """Clouds and pictures are those of the ticks, seen from where each episode's camera was."""
    rows, number = rows_of(converted), 0
    for episode, text in zip(cameras, Dataset(converted).table["recorded"].to_pylist(), strict=True):
        for tick in json.loads(text)["ticks"]:
            cloud = as_points(np.asarray(rows[number][schema.POINT_CLOUD]))
            wanted = calibration(episode).depth_pose[0, 3] + float(depth_at(tick).max()) / 1000.0
            assert np.abs(cloud[:, 0] - wanted).max() < 1e-3
            shade = float(rows[number][schema.FRONT_IMAGE].mean()) * 255.0
            assert abs(shade - tick % 250) < 4.0
            number += 1


def test_clouds_and_pictures_are_those_of_the_ticks(converted: Path) -> None:
    require_true_rows(converted, (0, 1))


def test_recordings_before_and_after_a_camera_was_moved_merge(recording: Path, tmp_path: Path) -> None:
    later = write_recording(tmp_path / "later", dense_episode(seed=3), moved=3)
    merge([recording, later], tmp_path / "all")
    convert([tmp_path / "all"], tmp_path / "converted", OPTIONS)
    require_true_rows(tmp_path / "converted", (0, 1, 3))
    save_calibration(later / CALIBRATIONS, "front", replace(calibration(), depth_in_color=np.eye(4)))
    with pytest.raises(DatasetError, match="different camera calibrations"):
        merge([recording, later], tmp_path / "refused")


def test_the_description_is_that_of_simulated_demonstrations(recording: Path, finished: Path, tmp_path: Path) -> None:
    simulated = read_info(finished)
    image = int(simulated["features"][schema.FRONT_IMAGE]["shape"][0])
    points = int(simulated["features"][schema.POINT_CLOUD]["shape"][0]) // 3
    convert([recording], tmp_path / "made", ConvertOptions(rows=RowOptions(points, image)))
    made = read_info(tmp_path / "made")

    def told(info: dict[str, Any]) -> dict[str, Any]:
        plain = json.loads(json.dumps(info))
        plain["features"][schema.FRONT_IMAGE]["info"].pop("intrinsics")  # of another camera
        return {key: value for key, value in plain.items() if not key.startswith("total_") and key != "splits"}

    assert told(made) == told(simulated)


def test_a_mix_has_both_and_passes_the_check(recording: Path, finished: Path, tmp_path: Path) -> None:
    made = convert([recording, finished], tmp_path / "mix", OPTIONS)
    simulated = read_info(finished)["total_episodes"]
    assert (made.episodes, made.simulated) == (2, simulated)
    assert read_info(tmp_path / "mix")["total_episodes"] == 2 + simulated
    # The fake environment's poses are no poses; nothing else is wrong, and nothing with the recording's episodes.
    findings = check(tmp_path / "mix").findings
    assert {each.kind for each in findings} <= {each.kind for each in check(finished).findings}
    assert all(each.episode is None or each.episode >= 2 for each in findings)
    assert not list(tmp_path.glob("mix.*"))


def test_the_camera_of_the_clouds_is_named_also_in_a_mix(
    recording: Path, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = DenseRecording.open
    monkeypatch.setattr(DenseRecording, "open", lambda root, camera: opened(root))  # its only camera is front
    for sources, camera in (([recording], "front"), ([recording], "side"), ([recording, finished], "side")):
        out = tmp_path / f"{camera}_{len(sources)}"
        convert(sources, out, replace(OPTIONS, camera=camera))
        assert camera_of(read_info(out)["features"]) == camera


def test_corrections_begin_where_somebody_takes_over(tmp_path: Path) -> None:
    episode = dense_episode(seed=3)
    ticks = np.arange(len(episode))
    rest = int(np.flatnonzero((episode.sent == STOPS[2].goal).all(axis=1))[0]) + 6
    corrected = replace(episode, corrected=ticks >= rest)
    root = write_recording(tmp_path / "rollout", corrected)
    assert check(root).clean  # LeRobot's own writer averages quantiles, which is a warning
    made = convert([root], tmp_path / "made", replace(OPTIONS, successful=True))
    assert made.episodes == 1
    rows = rows_of(tmp_path / "made")
    goals = np.stack([stop.goal for stop in STOPS[3:]])
    for key in (schema.ACTION, schema.EXECUTED):
        np.testing.assert_array_equal(np.stack([row[key] for row in rows[:-1]]), goals)
    assert [bool(row[schema.SUCCESS]) for row in rows] == [False] * (len(goals) - 1) + [True, True]
    assert json.loads(Dataset(tmp_path / "made").table["recorded"][0].as_py())["corrections"]


def test_of_the_interventions_of_a_successful_episode_the_one_at_its_end_succeeds(tmp_path: Path) -> None:
    """After the others the policy went on, and may have failed."""
    episode = dense_episode(seed=3)
    starts = [int(np.flatnonzero((episode.sent == stop.goal).all(axis=1))[0]) + 6 for stop in STOPS]
    ticks = np.arange(len(episode))
    none = np.zeros(len(episode), bool)
    for end, successes in ((len(episode), [False, True]), (len(episode) - 1, [False, False])):
        corrected = (ticks < starts[1]) | ((ticks >= starts[2]) & (ticks < end))
        root = write_recording(tmp_path / f"rollout_{end}", replace(episode, success=none, corrected=corrected))
        convert([root], tmp_path / f"made_{end}", replace(OPTIONS, successful=True))
        assert Dataset(tmp_path / f"made_{end}").table["success"].to_pylist() == successes


def test_episodes_are_counted_as_successes_where_nobody_reported_one(recording: Path, tmp_path: Path) -> None:
    """As in an episodic rollout, which has the columns of `lerobot-record` but nobody at the success key."""
    rollout = write_recording(tmp_path / "rollout", *(dense_episode(seed=seed, opens=False) for seed in (1, 2)))
    for root, successes in ((rollout, [True, True]), (recording, [True, False])):
        convert([root], tmp_path / f"made_{root.name}", replace(OPTIONS, successful=True))
        assert Dataset(tmp_path / f"made_{root.name}").table["success"].to_pylist() == successes


def test_a_success_at_a_last_tick_that_repeats_a_reading_counts() -> None:
    episode = dense_episode(seed=3)
    for values in (episode.state, episode.stamp):
        values[-1] = values[-2]
    episode = replace(episode, success=np.arange(len(episode)) == len(episode) - 1)
    chosen = choose_key_frames(episode, FPS)
    assert chosen.rows[-1] < len(episode) - 1
    pictures = lambda tick: (None, depth_at(tick)[..., 0])  # noqa: E731
    columns = demonstration_columns(episode, chosen, pictures, calibration(), RowOptions(POINTS, None))
    assert columns[schema.SUCCESS][:, 0].tolist() == [False] * (len(chosen.rows) - 1) + [True]


def test_what_a_roll_out_asked_for_outside_the_box_is_not_told_as_executed(tmp_path: Path) -> None:
    episode = dense_episode(seed=3)
    corrected = replace(episode, corrected=np.ones(len(episode), bool))
    root = write_recording(tmp_path / "rollout", corrected)
    highest = float(max(stop.goal[2] for stop in STOPS))
    limits = SafetyLimits((-2.0, -2.0, -2.0), (2.0, 2.0, highest - 0.05))
    ROBOTS.open("arm").safety = limits
    _keep_robot(root)  # as the recorder does
    ROBOTS.close("arm")
    assert limits_from_json((root / SAFETY).read_bytes()) == limits
    assert check(root).clean  # LeRobot's own writer averages quantiles, which is a warning
    recording = DenseRecording.open(root)
    read = recording.episode(0)
    for asked, sent in zip(read.asked[:-1], read.sent[1:], strict=True):
        assert limits.contains(pose_from_vector(sent)[0], 1e-6)
        np.testing.assert_array_equal(sent, accepted(asked, limits))
    assert (read.sent[1:] != read.asked[:-1]).any()
    (root / SAFETY).write_text("{}")
    with pytest.raises(DatasetError, match="box_lower"):
        DenseRecording.open(root).episode(0)


def test_what_a_corrector_asked_for_stands_beside_what_was_accepted() -> None:
    episode = dense_episode()
    asked = episode.asked.copy()
    asked[:, 2] += 0.01  # the safety filter took that off again
    asked[:, 9] *= 0.9  # a trigger that is not pulled all the way
    corrected = replace(episode, corrected=np.ones(len(episode), bool), asked=asked)
    chosen = choose_key_frames(corrected, FPS)
    pictures = lambda tick: (None, depth_at(tick)[..., 0])  # noqa: E731
    columns = demonstration_columns(corrected, chosen, pictures, calibration(), RowOptions(POINTS, None))
    goals = np.stack([stop.goal for stop in STOPS[1:]])
    np.testing.assert_array_equal(columns[schema.EXECUTED][:-1], goals)
    lifted = goals + np.eye(10, dtype=np.float32)[2] * np.float32(0.01)
    np.testing.assert_allclose(columns[schema.ACTION][:-1], lifted, atol=1e-6)


def test_what_cannot_be_converted_is_named(recording: Path, finished: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="no dense recording"):
        convert([finished], tmp_path / "made", OPTIONS)
    with pytest.raises(DatasetError, match="side_depth"):
        convert([recording], tmp_path / "made", replace(OPTIONS, camera="side"))
    root = Path(shutil.copytree(recording, tmp_path / "uncalibrated"))
    (root / CALIBRATIONS).unlink()
    with pytest.raises(DatasetError, match="calibration"):
        convert([root], tmp_path / "made", OPTIONS)
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("readings", ["state", "effort"])
def test_readings_that_are_no_numbers_are_refused(readings: str, tmp_path: Path) -> None:
    episode = dense_episode(STOPS[:2])
    getattr(episode, readings)[3, 0] = np.nan
    root = write_recording(tmp_path / "recording", episode)
    with pytest.raises(DatasetError, match="NaN is no number"):
        DenseRecording.open(root)
    repair(root)  # the statistics then leave the tick out; the episode stays as it was recorded
    with pytest.raises(DatasetError, match="NaN or infinity in the arm's state or effort"):
        DenseRecording.open(root).episode(0)


def test_an_episode_without_motion_is_left_out_on_request(tmp_path: Path) -> None:
    still = dense_episode((Stop((0.4, 0.0, 0.7), rest=20),))
    root = write_recording(tmp_path / "recording", still, dense_episode(STOPS[:2]))
    with pytest.raises(DatasetError, match="recording:0"):
        convert([root], tmp_path / "made", OPTIONS)
    made = convert([root], tmp_path / "made", replace(OPTIONS, skip_still=True))
    assert (made.episodes, made.skipped) == (1, ("recording:0",))
