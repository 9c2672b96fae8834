"""Dense recordings, made by hand: an arm that follows a streamed target with a lag, and stops at a wall."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import lerobot_patches
from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, POSE, STATES
from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, rotation_about, transform
from lerobot_adamanip.contract.schema import ACTION, DONE, POSE_NAMES, STATE, STATE_NAMES, SUCCESS
from lerobot_adamanip.hardware.arm import ArmMode, ArmReading
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, Intrinsics, save_calibration
from lerobot_adamanip.hardware.dense_kinds import encode_action, state_of
from lerobot_adamanip.hardware.features import (
    ARM,
    CALIBRATIONS,
    CAMERA_NAMES,
    DEPTH_SUFFIX,
    INTERVENTION,
    names_of,
    recorded_features,
)
from lerobot_adamanip.hardware.recorded_rows import recorded_row
from lerobot_adamanip.recordings.keyframe_choice import DenseEpisode

FPS = 30
SPEED, FOLLOWS, FINGERS, LEAD = 0.3, 0.4, 0.2, 0.04
WALL = 0.62
SIZE = 64
FOCAL = 60.0


class Stop(NamedTuple):
    """Where a person stops: position [m], turn about z [rad], gripper, ticks of rest."""

    position: tuple[float, float, float]
    turn: float = 0.0
    gripper: float = 1.0
    rest: int = 12

    @property
    def goal(self) -> NDArray[np.float32]:
        return pose_vector(transform(self.position, rotation_about((0, 0, 1), self.turn)), self.gripper)


STOPS = (
    Stop((0.40, 0.0, 0.70)),
    Stop((0.50, 0.1, 0.70), 0.3),
    Stop((0.50, 0.1, 0.70), 0.3, 0.0),  # closes the hand where it is
    Stop((0.655, 0.1, 0.70), 0.3, 0.0),  # against the wall
    Stop((0.45, -0.1, 0.75), 0.3, 0.0),
    Stop((0.45, -0.1, 0.75), 0.3, 1.0),
    Stop((0.38, -0.1, 0.80), 0.0, 1.0),
)


def goal_between(start: Stop, end: Stop, share: float, gripper: float) -> NDArray[np.float32]:
    position = (1 - share) * np.array(start.position) + share * np.array(end.position)
    turn = (1 - share) * start.turn + share * end.turn
    return pose_vector(transform(position, rotation_about((0, 0, 1), turn)), gripper)


def streamed(stops: Sequence[Stop]) -> list[NDArray[np.float32]]:
    """Targets, tick by tick."""
    targets = [stops[0].goal] * stops[0].rest
    for start, end in itertools.pairwise(stops):
        way = float(np.linalg.norm(np.subtract(end.position, start.position))) + 0.1 * abs(end.turn - start.turn)
        ticks = int(np.ceil(way / SPEED * FPS))
        targets += [goal_between(start, end, tick / ticks, start.gripper) for tick in range(1, ticks)]
        targets += [end.goal] * end.rest
    return targets


def jumped(stops: Sequence[Stop], ticks: int = 30) -> list[NDArray[np.float32]]:
    """Targets of key frames that are sent whole."""
    return [stop.goal for stop in stops for _ in range(ticks)]


def dense_episode(
    stops: Sequence[Stop] = STOPS,
    *,
    seed: int = 0,
    noise: float = 1e-4,
    opens: bool = True,
    how: Callable[[Sequence[Stop]], list[NDArray[np.float32]]] = streamed,
) -> DenseEpisode:
    """What a robot would have told while it followed these stops."""
    draw = np.random.default_rng(seed)
    targets = np.stack(how(stops))
    pose = targets[0].astype(np.float64)
    states, sent = [], [targets[0]]
    for target in targets:
        state = np.zeros(24, np.float32)
        state[:10] = pose
        state[:3] += draw.normal(scale=noise, size=3)
        states.append(state)
        sent.append(target)
        pose = pose + FOLLOWS * (target - pose)
        pose[0] = min(pose[0], WALL)
        rows = np.linalg.qr(pose[3:9].reshape(2, 3).T)[0].T
        pose[3:9] = (rows * np.sign((rows * pose[3:9].reshape(2, 3)).sum(axis=1))[:, None]).reshape(6)
        pose[9] = np.clip(pose[9] + np.clip(target[9] - pose[9], -FINGERS, FINGERS), 0, 1)
    count = len(targets)
    success = np.zeros(count, bool)
    success[-5:] = opens
    return DenseEpisode(
        state=np.stack(states),
        effort=np.zeros((count, 7), np.float32),
        sent=np.stack(sent[:-1]),
        stamp=np.arange(count) / FPS,
        outcome=np.full(count, -1),
        success=success,
        task="open the thing",
        asked=targets,
    )


def arm_rows(episode: DenseEpisode) -> NDArray[np.float32]:
    """Values of the column `ARM`."""
    ends = np.stack([episode.outcome, episode.stamp], axis=1)
    camera = np.zeros((len(episode), len(CAMERA_NAMES)))
    return np.concatenate([episode.state, episode.effort, episode.sent, ends, camera], axis=1).astype(np.float32)


def depth_at(tick: int) -> NDArray[np.uint16]:
    """A wall that nears by a millimetre per tick, and a hole."""
    depth = np.full((SIZE, SIZE, 1), 900 - tick % 100, np.uint16)
    depth[: SIZE // 4] = 0
    return depth


def calibration(episode: int = 0) -> CameraCalibration:
    """A camera at the base that looks along x. It is moved by 5 cm after each episode."""
    middle = SIZE / 2
    matrix = np.array([[FOCAL, 0, middle], [0, FOCAL, middle], [0, 0, 1.0]])
    looks = transform((-0.3 + 0.05 * episode, 0.0, 0.75), np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.float64))
    return CameraCalibration("front", Intrinsics(matrix, np.zeros(0), SIZE, SIZE), looks)


def dense_features(
    state: Sequence[str] = STATES[POSE], action: Sequence[str] = ACTION_NAMES[EE_DELTA]
) -> dict[str, dict[str, Any]]:
    """What LeRobot makes of a robot's features."""
    picture = {"dtype": "video", "names": ["height", "width", "channels"]}
    return {
        STATE: {"dtype": "float32", "shape": (len(state),), "names": list(state)},
        ACTION: {"dtype": "float32", "shape": (len(action),), "names": list(action)},
        "observation.images.front": {**picture, "shape": (SIZE, SIZE, 3)},
        f"observation.images.front{DEPTH_SUFFIX}": {
            **picture, "shape": (SIZE, SIZE, 1), "info": {"is_depth_map": True},
        },
    }  # fmt: skip


def begun(root: Path, features: dict[str, Any] | None = None) -> Any:
    from lerobot.configs.video import DepthEncoderConfig, RGBEncoderConfig
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    return LeRobotDataset.create(
        "local/dense",
        FPS,
        features or recorded_features(dense_features()),
        root=root,
        robot_type="adamanip_franka",
        rgb_encoder=RGBEncoderConfig(vcodec="h264"),
        depth_encoder=DepthEncoderConfig(depth_min=0.0, depth_max=2.0),
    )


def reading_at(episode: DenseEpisode, tick: int) -> ArmReading:
    pose, gripper = pose_from_vector(episode.state[tick, :10])
    qpos, qvel, stamp = episode.state[tick, 10:17], episode.state[tick, 17:], float(episode.stamp[tick])
    return ArmReading(stamp, stamp, pose, gripper, qpos, qvel, episode.effort[tick], ArmMode.IDLE)


def frames(episode: DenseEpisode, features: dict[str, Any], number: int = 0) -> Iterator[dict[str, Any]]:
    """Rows of episode ``number`` as the recorder adds them, or as LeRobot does without its columns."""
    for tick, reading in enumerate(reading_at(episode, tick) for tick in range(len(episode))):
        frame = {
            STATE: arm_rows(episode)[tick][: len(names_of(features[STATE]))],
            ACTION: episode.asked[tick],
            "observation.images.front": np.full((SIZE, SIZE, 3), tick % 250, np.uint8),
            f"observation.images.front{DEPTH_SUFFIX}": depth_at(tick),
            "task": episode.task,
        }
        if ARM in features:
            action = encode_action(EE_DELTA, episode.asked[tick], reading)
            frame |= recorded_row(EE_DELTA, reading, episode.sent[tick], reading.stamp, calibration(number))
            frame |= {STATE: state_of(POSE, reading), ACTION: np.array(list(action.values()), np.float32)}
            frame[SUCCESS] = episode.success[tick : tick + 1]
            frame[DONE] = np.array([tick == len(episode) - 1])
        if episode.corrected is not None:
            frame[INTERVENTION] = episode.corrected[tick : tick + 1]
        yield {key: value for key, value in frame.items() if key in features or key == "task"}


def add(dataset: Any, episode: DenseEpisode, moved: int = 0) -> None:
    for frame in frames(episode, dataset.meta.features, moved + dataset.num_episodes):
        dataset.add_frame(frame)


def write_recording(root: Path, *episodes: DenseEpisode, moved: int = 0) -> Path:
    """Writes a recording as `lerobot-record` does; with corrections, as `lerobot-rollout` does without our recorder."""
    lerobot_patches.restore()  # which would add its columns to the latter
    features = None
    if episodes[0].corrected is not None:
        taken_over = {"dtype": "bool", "shape": (1,), "names": None}
        features = {**dense_features(STATE_NAMES, POSE_NAMES), INTERVENTION: taken_over}
    dataset = begun(root, features)
    for episode in episodes:
        add(dataset, episode, moved)
        dataset.save_episode(parallel_encoding=False)
    dataset.finalize()
    save_calibration(root / CALIBRATIONS, "front", calibration(moved))
    return root
