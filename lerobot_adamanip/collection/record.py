"""Recording of episodes in a worker with a simulator. Results are the bytes of episode files.

A worker needs no access to the collection's folder: a local worker writes itself, for a cluster the driver writes.
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.corrections import (
    Actor,
    ActorFactory,
    Correcting,
    corrected_rollout,
    dense_corrected_rollout,
)
from lerobot_adamanip.collection.late_starts import draw_start, start_late
from lerobot_adamanip.collection.mistakes import MistakenExpert, Mistakes, mistaken_rollout
from lerobot_adamanip.collection.tries_so_far import DenseTries, KeyFrameTries, followed
from lerobot_adamanip.contract.keyframes import KeyFrames
from lerobot_adamanip.contract.schema import ACTION_DIM
from lerobot_adamanip.contract.seeds import Stream, episode_generator
from lerobot_adamanip.contract.versions import DATA_VERSION, SIMULATION_VERSION, cpu_model
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, EpisodeSpec, episode_seed
from lerobot_adamanip.datasets.episode import EpisodeDescription, start_column
from lerobot_adamanip.datasets.manifest import differing_parts
from lerobot_adamanip.datasets.shards import RecordedEpisode, shard_bytes, write_shard_bytes
from lerobot_adamanip.episode.dense import DenseEnvironment, DenseRecorder, DenseRun, DenseStep, dense_rollout
from lerobot_adamanip.episode.memory import with_row_tasks
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.rollout import (
    EpisodeRecorder,
    KeyFrame,
    KeyFrameRun,
    RolloutResult,
    SimulatedEnvironment,
    rollout,
)
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import DatasetError, UnreachableError
from lerobot_adamanip.util.jobs import Heartbeat

EnvFactory = Callable[[EnvironmentOptions], SimulatedEnvironment]
"""Builds an environment. Must be a module-level function or a `functools.partial` of one, to be sent to workers."""
ExpertFactory = Callable[..., KeyFrames]
"""Creates an expert; arguments of `lerobot_adamanip.experts.make_expert`. Must be module-level, too."""
Hidden = Mapping[str, Any]


@dataclass(frozen=True)
class Factories:
    """Factories of a collection: objects of this program, never names from a file.

    Attributes:
        environment: builds environments.
        expert: creates experts.
        actor: loads the policy to correct; None if experts demonstrate.
    """

    environment: EnvFactory
    expert: ExpertFactory
    actor: ActorFactory | None = None


@dataclass(frozen=True)
class RecordingJob:
    """Settings that a worker needs to record episodes.

    Attributes:
        spec: specification of the collection.
        factories: factories of environments and experts.
        max_attempts: maximum number of seeds per episode.
        versions: required software versions of every environment.
    """

    spec: CollectionSpec
    factories: Factories
    max_attempts: int
    versions: Mapping[str, str]


@dataclass(frozen=True)
class Attempt:
    """One attempted episode.

    Attributes:
        seed: seed of the episode.
        hidden_state: sampled values; None if no reachable layout was found.
        success: whether the expert succeeded.
        reason: ``success``, or the cause of failure.
        key_frames: number of key frames, or of steps at control rate.
        late: whether it had a late start.
    """

    seed: int
    hidden_state: Hidden | None
    success: bool
    reason: str
    key_frames: int
    late: bool


@dataclass(frozen=True)
class EpisodeRequest:
    """Request for one attempt at an episode.

    Attributes:
        object_id: id of the object.
        seed: seed of the episode.
        overrides: hidden values; None to sample them.
        slot: number of the episode among those of its object.
        earlier: attempts before this one.
    """

    object_id: str
    seed: int
    overrides: Hidden | None = None
    slot: int = 0
    earlier: Sequence[Attempt] = ()


@dataclass(frozen=True)
class ItemOutcome:
    """Result of an item.

    Attributes:
        attempts: all attempts, in order.
        kept: whether the last attempt is kept: a success, or any episode of a corrected policy.
        failed: attempt -> file content of a failed episode to keep; empty once written.
        episode: file content of the kept episode; None once written.
    """

    attempts: tuple[Attempt, ...]
    kept: bool = False
    failed: Mapping[int, bytes] = field(default_factory=dict)
    episode: bytes | None = None


# Workers --------------------------------------------------------------------------------------------------------------


class Environments:
    """Builds environments, one at a time, for the last requested category. Use as a context manager."""

    def __init__(self, make: EnvFactory, spec: CollectionSpec) -> None:
        self._make, self._spec = make, spec
        self._category = ""
        self._env: SimulatedEnvironment | None = None

    def of(self, category: str) -> SimulatedEnvironment:
        """Returns an environment of a category."""
        if self._env is None or category != self._category:
            self.__exit__()
            self._category, self._env = category, self._make(self._spec.environment_of(category))
        return self._env

    def __enter__(self) -> Environments:
        return self

    def __exit__(self, *_: object) -> None:
        if self._env is not None:
            self._env.close()
        self._env = None


@contextlib.contextmanager
def recording_session(job: RecordingJob) -> Iterator[Callable[[EpisodeSpec, Heartbeat], ItemOutcome]]:
    """Yields a worker's function that records an item; it keeps one simulator until the category changes."""
    actor = None if job.factories.actor is None else job.factories.actor()

    def make(options: EnvironmentOptions) -> SimulatedEnvironment:
        env = job.factories.environment(options)
        versions = env.software_versions()
        if parts := differing_parts(versions, job.versions):
            raise DatasetError(
                f"A worker has other versions than the collection: {', '.join(parts)} differ.",
                got="; ".join(f"{name} = {versions.get(name)}" for name in parts),
                allowed="; ".join(f"{name} = {job.versions.get(name)}" for name in parts),
                hint="the same command again; was the code or a package changed meanwhile?",
            )
        return env

    with Environments(make, job.spec) as environments:
        yield lambda item, beat: record_item(environments.of(category_of(item.object_id)), job, item, beat, actor)


@contextlib.contextmanager
def writing_session(
    job: RecordingJob, paths: CollectionPaths
) -> Iterator[Callable[[EpisodeSpec, Heartbeat], ItemOutcome]]:
    """Yields a function like `recording_session`, for local workers, that also writes the episodes."""
    with recording_session(job) as record:
        yield lambda item, beat: write_outcome(paths, item, record(item, beat))


def write_outcome(paths: CollectionPaths, item: EpisodeSpec, outcome: ItemOutcome) -> ItemOutcome:
    """Writes an outcome durably, with the file that marks it as done last; returns it without file contents."""
    for number, content in sorted(outcome.failed.items()):
        name = item.file_name.replace(".safetensors", f"-{number:03d}.safetensors")
        write_shard_bytes(paths.failed_episodes / name, content)
    if outcome.episode is not None:
        write_shard_bytes(paths.episodes / item.file_name, outcome.episode)
    else:
        attempts = json.dumps([vars(attempt) for attempt in outcome.attempts], sort_keys=True)
        files.write_atomically(attempts_file(paths, item), attempts.encode())
    return replace(outcome, failed={}, episode=None)


def attempts_file(paths: CollectionPaths, item: EpisodeSpec) -> Path:
    """Returns the file with the attempts at a given-up item."""
    return paths.attempts / item.file_name.replace(".safetensors", ".json")


# Episodes -------------------------------------------------------------------------------------------------------------


def record_item(
    env: SimulatedEnvironment, job: RecordingJob, item: EpisodeSpec, beat: Heartbeat, actor: Actor | None = None
) -> ItemOutcome:
    """Attempts seeds until the expert succeeds; for a policy's corrections, until a scene is reachable.

    Every attempt uses the hidden state of the first one: otherwise hard hidden states would become rare.
    """
    attempts: list[Attempt] = []
    failed: dict[int, bytes] = {}
    hidden: Hidden | None = None
    for number in range(job.max_attempts):
        seed = episode_seed(job.spec.seed, category_of(item.object_id), item.object_id, item.slot, number)
        request = EpisodeRequest(item.object_id, seed, hidden, item.slot, tuple(attempts))
        try:
            attempt, episode = attempt_episode(env, job.spec, job.factories.expert, request, beat, actor=actor)
        except UnreachableError as error:
            attempts.append(Attempt(seed, hidden, False, f"unreachable: {error}".partition("\n")[0], 0, False))
            if error.is_certain:
                break
            continue
        attempts.append(attempt)
        hidden = attempt.hidden_state
        if attempt.success or (actor is not None and episode.columns):
            return ItemOutcome(tuple(attempts), True, failed, shard_bytes(episode))
        if job.spec.keep_failed and episode.columns:
            failed[number] = shard_bytes(episode)
    return ItemOutcome(tuple(attempts), failed=failed)


def attempt_episode(
    env: SimulatedEnvironment,
    spec: CollectionSpec,
    make_expert: ExpertFactory,
    request: EpisodeRequest,
    beat: Heartbeat = lambda: None,
    *,
    actor: Actor | None = None,
) -> tuple[Attempt, RecordedEpisode]:
    """Records one episode, successful or not: an expert's, or a policy's with expert corrections."""
    observation, prefix = _start(env, spec, make_expert, request)
    hidden, camera, late = env.hidden_state(), env.camera_parameters(), bool(len(prefix))
    dense = cast("DenseEnvironment", env) if spec.environment.is_dense else None
    recorder: Any = EpisodeRecorder(env.joints) if dense is None else DenseRecorder(dense)

    def record(step: KeyFrame | DenseStep) -> None:
        recorder.record(step)
        beat()

    expert = functools.partial(_expert, env, spec, make_expert, request)
    result = _drive(env, observation, record, spec, request, expert=expert, actor=actor, late=late)
    episode_record = env.episode_record()
    is_kept = result.success or actor is not None
    description = EpisodeDescription(
        object_id=request.object_id,
        seed=request.seed,
        expert=spec.expert,
        tries=len(episode_record["try_sequence"]),
        failed_tries=sum(failed for _, _, failed in episode_record["try_sequence"]),
        success=result.success,
        attempt=len(request.earlier),
        slot=request.slot,
        late=late,
        simulation_version=SIMULATION_VERSION,
        data_version=DATA_VERSION,
        hidden_state=hidden,
        hidden_overrides=None if request.overrides is None else dict(request.overrides),
        start=start_column(prefix),
        camera=camera,
        versions={**env.software_versions(), "cpu": cpu_model()},
        failures=[vars(attempt) for attempt in request.earlier] if is_kept else [],
        episode_record=episode_record,
    )
    attempt = Attempt(request.seed, hidden, result.success, result.reason, episode_record["key_frames"], late)
    columns = recorder.columns()
    record_of_rows = with_row_tasks(description.record(env.task_description), columns, spec.environment)
    return attempt, RecordedEpisode(columns, record_of_rows)


def _drive(
    env: SimulatedEnvironment,
    observation: Any,
    record: Callable[[Any], None],
    spec: CollectionSpec,
    request: EpisodeRequest,
    *,
    expert: Callable[..., KeyFrames],
    actor: Actor | None,
    late: bool,
) -> RolloutResult:
    """Drives an episode from its first observation on, and records each step."""
    dense = cast("DenseEnvironment", env) if spec.environment.is_dense else None
    category, take_over = category_of(request.object_id), functools.partial(expert, late=True)
    if actor is not None:
        rng = episode_generator(request.seed, Stream.CORRECTION, category)
        correcting = Correcting(actor, take_over, spec.expert_share, request.seed, rng)
        corrected: Any = corrected_rollout if dense is None else dense_corrected_rollout
        return cast("RolloutResult", corrected(env, observation, correcting, record))
    if spec.mistakes == 0:
        demonstrated: Any = rollout if dense is None else dense_rollout
        return cast("RolloutResult", demonstrated(env, observation, expert(late=late), record, past_success=True))
    rng = episode_generator(request.seed, Stream.MISTAKE, category)
    driver = MistakenExpert(expert(late=late), take_over, Mistakes(spec.mistakes, rng), rng)
    if dense is None:
        run = KeyFrameRun(env, observation, record, past_success=True)
        return mistaken_rollout(run, KeyFrameTries(env), driver)
    tries = DenseTries(dense)
    return mistaken_rollout(DenseRun(dense, observation, followed(tries, record), past_success=True), tries, driver)


def _start(
    env: SimulatedEnvironment, spec: CollectionSpec, make_expert: ExpertFactory, request: EpisodeRequest
) -> tuple[Any, NDArray[np.float32]]:
    """Resets, then executes the late start if the seed has one; returns the first observation and the actions."""
    category = category_of(request.object_id)
    reset = functools.partial(reset_scene, env, request.object_id, request.seed, request.overrides)
    start = draw_start(request.seed, category, spec.late_starts)
    if start is None:
        return reset(), np.zeros((0, ACTION_DIM), np.float32)

    def driver(generator: np.random.Generator) -> KeyFrames:
        # Always static, so that adaptive and static collections have the same late starts.
        rules, hidden = spec.environment.mechanism_rules, env.hidden_state()
        return make_expert(
            category, "static", env.annotations, generator=generator, hidden=hidden, mechanism_rules=rules
        )

    return start_late(env, start, reset, driver)


def reset_scene(env: SimulatedEnvironment, object_id: str, seed: int, overrides: Hidden | None) -> Any:
    """Starts the scene of an episode, at rest; returns the first observation."""
    hidden = {} if overrides is None else {"hidden_overrides": dict(overrides)}
    return env.reset(seed=seed, options={"object_id": object_id, **hidden})[0]


def _expert(
    env: SimulatedEnvironment,
    spec: CollectionSpec,
    make_expert: ExpertFactory,
    request: EpisodeRequest,
    *,
    late: bool,
    generator: np.random.Generator | None = None,
    **known: Any,
) -> KeyFrames:
    """Returns the expert of an episode. After a late start it knows the part positions and the feedback."""
    category = category_of(request.object_id)
    return make_expert(
        category,
        spec.expert,
        env.annotations,
        trials=spec.trials,
        generator=generator or episode_generator(request.seed, Stream.EXPERT, category),
        hidden=env.hidden_state() if spec.expert == "static" else None,
        strategy=spec.expert_strategy,
        mechanism_rules=spec.environment.mechanism_rules,
        positions=env.part_positions() if late else None,
        feedback=env.feedback if late else None,
        **known,
    )
