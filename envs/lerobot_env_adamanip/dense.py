"""Record simulated episodes tick by tick, as a robot's recorder does, beside their true key frames.

So the search for key frames can be measured. There are no pictures: a render takes as long as a hundred ticks.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip import lerobot_patches
from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.record import EpisodeRequest, ExpertFactory, attempt_episode
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.datasets.collection_spec import CollectionSpec, EpisodeSpec, episode_seed
from lerobot_adamanip.datasets.output_folder import WRITING, is_free, owned_output
from lerobot_adamanip.hardware.features import KEY_FRAMES, SCALAR_NAMES
from lerobot_adamanip.recordings.keyframe_choice import DenseEpisode
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError, UnreachableError
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

FPS = 50
"""Control ticks per second: every one is recorded."""
ROBOT_TYPE = "adamanip_dense"
"""Of such recordings."""
_MOST_ATTEMPTS = 100
"""Attempts per episode at most whose seeds are known again."""
Progress = Callable[[str, int, int], None]


@dataclass
class TickWatch:
    """Records the control ticks of an environment.

    Attributes:
        env: the environment; it is watched from now on.
        rows: state (24,), effort (7,) and goal (10,) of each tick, before it.
        ends: rows at which key frames had ended.
        successes: whether the task was done, at each of these.
    """

    env: KeyframeEnv
    rows: list[tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    successes: list[bool] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._sim = self.env._started()
        tick = self._sim._tick

        def watched(target: NDArray[np.float64], velocity: NDArray[np.float64], finger: float) -> None:
            self.rows.append((*self._seen(), self._goal()))
            tick(target, velocity, finger)

        # The driver of an episode is given the task's `_tick` when it is built, at reset.
        self._sim._tick = watched  # type: ignore[method-assign]

    def begin(self) -> None:
        """Starts an episode: call it before the reset."""
        self.rows, self.ends, self.successes = [], [], []

    def key_frame_ended(self) -> None:
        """Marks the end of a key frame."""
        self.ends.append(len(self.rows))
        self.successes.append(self._sim.succeeded())

    def episode(self, task: str) -> DenseEpisode:
        """Returns the ticks since `begin`."""
        state, effort, asked = (
            np.stack(column) for column in zip(*self.rows, (*self._seen(), self._goal()), strict=True)
        )
        done = np.zeros(len(state), bool)
        for end, success in zip(self.ends, self.successes, strict=True):
            done[end:] |= success
        return DenseEpisode(
            state=state,
            effort=effort,
            sent=np.concatenate([state[:1, : schema.ACTION_DIM], asked[:-1]]),
            stamp=np.arange(len(state)) / FPS,
            outcome=np.full(len(state), -1),
            success=done,
            task=task,
            asked=asked,
        )

    def _seen(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        arm, driver = self._sim.arm_state(), self._sim._arm
        here = driver._feedback(None)
        pose = pose_vector(here.tcp_in_base, float(np.clip(here.gripper, 0.0, 1.0)))
        state = np.concatenate([pose, arm.qpos, arm.qvel]).astype(np.float32)
        return state, driver._torque(arm).astype(np.float32)

    def _goal(self) -> NDArray[np.float32]:
        return pose_vector(*self._sim.goal)


@dataclass(frozen=True)
class KnownKeyFrames:
    """The key frames of a dense episode, as they were driven.

    Attributes:
        object_id, seed: of the episode.
        ends: (K,) ticks at which they had ended.
        actions: (K, 10) that were commanded.
        outcomes: (K,) `lerobot_adamanip.contract.keyframes.Outcome`.
        success: whether the task was done.
    """

    object_id: str
    seed: int
    ends: NDArray[np.int64]
    actions: NDArray[np.float32]
    outcomes: NDArray[np.int64]
    success: bool

    def to_json(self) -> dict[str, Any]:
        """Returns a JSON-able dictionary."""
        arrays = {name: getattr(self, name).tolist() for name in ("ends", "actions", "outcomes")}
        return {"object_id": self.object_id, "seed": self.seed, "success": self.success, **arrays}


def dense_episode(
    watch: TickWatch, spec: CollectionSpec, make_expert: ExpertFactory, request: EpisodeRequest
) -> tuple[DenseEpisode, KnownKeyFrames]:
    """Runs an expert through an episode; returns its ticks and its key frames."""
    watch.begin()
    attempt, recorded = attempt_episode(watch.env, spec, make_expert, request, watch.key_frame_ended)
    columns = recorded.columns
    known = KnownKeyFrames(
        request.object_id,
        request.seed,
        np.array(watch.ends, np.int64),
        columns[schema.ACTION][:-1],
        columns[schema.OUTCOME][:-1, 0].astype(np.int64),
        attempt.success,
    )
    return watch.episode(watch.env.task_description), known


def successful_episode(
    watch: TickWatch, spec: CollectionSpec, make_expert: ExpertFactory, item: EpisodeSpec, max_attempts: int
) -> tuple[DenseEpisode, KnownKeyFrames]:
    """Runs `dense_episode` for one seed after another until the expert succeeds; else raises `DatasetError`."""
    category = category_of(item.object_id)
    for attempt in range(max_attempts):
        seed = episode_seed(spec.seed, category, item.object_id, item.slot, attempt)
        try:
            episode, known = dense_episode(watch, spec, make_expert, EpisodeRequest(item.object_id, seed))
        except UnreachableError:
            continue
        if known.success:
            return episode, known
    raise DatasetError(
        "The expert did not succeed.",
        got=f"{item}, {max_attempts} attempts",
        allowed="a success",
        hint="--max-attempts",
    )


def collect_dense(
    root: Path,
    spec: CollectionSpec,
    make_expert: ExpertFactory,
    *,
    max_attempts: int,
    progress: Progress = lambda stage, done, total: None,
) -> int:
    """Records successful episodes tick by tick, in LeRobot's format; resumes an interrupted recording.

    Args:
        root: of the recording.
        spec: of the collection; late starts are left out.
        make_expert: makes experts.
        max_attempts: seeds to try per episode.
        progress: called after each episode.

    Returns:
        Number of episodes.

    Raises:
        DatasetError: an expert did not succeed, or there is something else at ``root``.
    """
    root = _claimed(root, spec)
    items, dataset, watches = spec.items(), _opened(root), _Watches(spec)
    try:
        for number in range(dataset.meta.total_episodes, len(items)):
            watch = watches.of(category_of(items[number].object_id))
            episode, known = successful_episode(watch, spec, make_expert, items[number], max_attempts)
            _save(dataset, episode, known, number)
            progress("record", number + 1, len(items))
    finally:
        watches.close()
        dataset.finalize()
    return int(dataset.meta.total_episodes)


class _Watches:
    """Watches of one category's environment after the other."""

    def __init__(self, spec: CollectionSpec) -> None:
        self._spec = spec
        self._env: KeyframeEnv | None = None

    def of(self, category: str) -> TickWatch:
        if self._env is None or self._env.category != category:
            self.close()
            self._env = KeyframeEnv(options=self._spec.environment_of(category).changed(observe_images=False))
            self._watch = TickWatch(self._env)
        return self._watch

    def close(self) -> None:
        if self._env is not None:
            self._env.close()


def _opened(root: Path) -> Any:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    lerobot_patches.apply()
    if (root / "meta" / "info.json").exists():
        return LeRobotDataset.resume(f"local/{root.name}", root=root)
    features = {
        schema.STATE: {"dtype": "float32", "shape": (len(SCALAR_NAMES),), "names": list(SCALAR_NAMES)},
        schema.ACTION: {"dtype": "float32", "shape": (schema.ACTION_DIM,), "names": list(schema.POSE_NAMES)},
    }
    return LeRobotDataset.create(f"local/{root.name}", FPS, features, root=root, robot_type=ROBOT_TYPE)


def _save(dataset: Any, episode: DenseEpisode, known: KnownKeyFrames, number: int) -> None:
    """Writes the key frames first: after a kill in between, their line is replaced."""
    path = Path(dataset.root) / KEY_FRAMES
    before = path.read_text(encoding="utf-8").splitlines()[:number] if path.exists() else []
    lines = [*before, json.dumps(known.to_json())]
    files.write_atomically(path, ("\n".join(lines) + "\n").encode())
    told = np.stack([episode.outcome, episode.stamp, episode.success], axis=1)
    values = np.concatenate([episode.state, episode.effort, episode.sent, told], axis=1).astype(np.float32)
    for row, asked in zip(values, episode.asked, strict=True):
        dataset.add_frame({schema.STATE: row, schema.ACTION: asked, "task": episode.task})
    dataset.save_episode()


def _claimed(target: Path, spec: CollectionSpec) -> Path:
    """Returns where to record, checked; the recording locks it itself."""
    with owned_output(target, WRITING) as output:
        if not is_free(output.root):
            _require_same_recording(output.root, spec)
        else:
            output.require_free()
            if output.root.exists():
                output.root.rmdir()  # LeRobot makes it
    return output.root


def _require_same_recording(root: Path, spec: CollectionSpec) -> None:
    """Raises `DatasetError` unless the episodes of a recording are the first ones of a collection."""
    try:
        info = json.loads((root / "meta" / "info.json").read_text(encoding="utf-8"))
        if (info["robot_type"], info["total_episodes"]) == (ROBOT_TYPE, 0):
            return  # killed before the first episode was saved
        lines = (root / KEY_FRAMES).read_text(encoding="utf-8").splitlines()
        found = [(known["object_id"], known["seed"]) for known in map(json.loads, lines)]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _another_recording(root, f"no dense collection: {type(error).__name__}") from error
    items = spec.items()
    for number, (object_id, seed) in enumerate(found):
        item = items[number] if number < len(items) else None
        if item is None or object_id != item.object_id or seed not in _seeds(spec, item):
            raise _another_recording(root, f"episode {number} is of {object_id}, seed {seed}")


def _seeds(spec: CollectionSpec, item: EpisodeSpec) -> set[int]:
    category = category_of(item.object_id)
    return {episode_seed(spec.seed, category, item.object_id, item.slot, number) for number in range(_MOST_ATTEMPTS)}


def _another_recording(root: Path, got: str) -> DatasetError:
    return DatasetError(
        "There is something else at the root of the recording.",
        got=f"{root}: {got}",
        allowed="a folder that does not exist, is empty, or was recorded with the same options",
        hint="another folder",
    )
