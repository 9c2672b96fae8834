"""Recording of episodes in a worker with a simulator. Results are the bytes of episode files.

A worker needs no access to the collection's folder: a local worker writes itself, for a cluster the driver writes.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.collection.corrections import Actor, ActorFactory, Correcting, corrected_rollout
from lerobot_adamanip.collection.late_starts import draw_start, start_late
from lerobot_adamanip.collection.outcome import Attempt, Hidden, ItemOutcome, write_outcome
from lerobot_adamanip.collection.recorder import EpisodeRecorder
from lerobot_adamanip.contract.keyframes import KeyFrames
from lerobot_adamanip.contract.seeds import Stream, episode_generator
from lerobot_adamanip.contract.versions import DATA_VERSION, SIMULATION_VERSION, cpu_model
from lerobot_adamanip.datasets.collection_spec import CollectionPaths, CollectionSpec, EpisodeSpec, episode_seed
from lerobot_adamanip.datasets.episode import start_column
from lerobot_adamanip.datasets.manifest import differing_parts
from lerobot_adamanip.datasets.shards import RecordedEpisode, shard_bytes
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.episode.rollout import SimulatedEnvironment, rollout
from lerobot_adamanip.util.errors import DatasetError, UnreachableError
from lerobot_adamanip.util.jobs import Heartbeat

EnvFactory = Callable[[EnvironmentOptions], SimulatedEnvironment]
"""Builds an environment. Must be a module-level function or a `functools.partial` of one, to be sent to workers."""
ExpertFactory = Callable[..., KeyFrames]
"""Creates an expert; arguments of `lerobot_adamanip.experts.make_expert`. Must be module-level, too."""


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
class EpisodeRequest:
    """Request for one attempt: object, seed, and optionally fixed hidden values."""

    object_id: str
    seed: int
    overrides: Hidden | None = None


@dataclass(frozen=True)
class RecordingJob:
    """Settings that a worker needs to record episodes.

    Attributes:
        spec: specification of the collection.
        factories: of environments and experts.
        max_attempts: maximum number of seeds per episode.
        versions: required software versions of every environment.
    """

    spec: CollectionSpec
    factories: Factories
    max_attempts: int
    versions: Mapping[str, str]


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
        _require_versions(env, job)
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


def _require_versions(env: SimulatedEnvironment, job: RecordingJob) -> None:
    found = env.software_versions()
    if parts := differing_parts(found, job.versions):
        raise DatasetError(
            f"A worker has other versions than the collection: {', '.join(parts)} differ.",
            got="; ".join(f"{name} = {found.get(name)}" for name in parts),
            allowed="; ".join(f"{name} = {job.versions.get(name)}" for name in parts),
            hint="the same command again; was the code or a package changed meanwhile?",
        )


def record_item(
    env: SimulatedEnvironment, job: RecordingJob, item: EpisodeSpec, beat: Heartbeat, actor: Actor | None = None
) -> ItemOutcome:
    """Attempts seeds until the expert succeeds; for a policy's corrections, until a scene is reachable.

    Every attempt uses the hidden state of the first one: otherwise hard hidden states would become rare.
    """
    attempts: list[Attempt] = []
    failed: dict[int, bytes] = {}
    hidden: Hidden | None = None
    category = category_of(item.object_id)
    for number in range(job.max_attempts):
        seed = episode_seed(job.spec.seed, category, item.object_id, item.slot, number)
        request = EpisodeRequest(item.object_id, seed, hidden)
        try:
            attempt, episode = attempt_episode(env, job.spec, job.factories.expert, request, beat, actor=actor)
        except UnreachableError as error:
            attempts.append(Attempt(seed, hidden, False, f"unreachable: {error}".partition("\n")[0], 0, False))
            if error.is_certain:
                break
            continue
        attempts.append(attempt)
        hidden = attempt.hidden_state
        record = {**episode.record, "slot": item.slot, "attempt": number}
        if attempt.success or (actor is not None and episode.columns):
            failures = [vars(each) for each in attempts[:-1]]
            record |= {"attempts": number + 1, "failures": failures, "late": attempt.late}
            content = shard_bytes(RecordedEpisode(episode.columns, record))
            return ItemOutcome(tuple(attempts), True, failed, content)
        if job.spec.keep_failed and episode.columns:
            record |= {"attempts": 1, "failures": [], "late": attempt.late}
            failed[number] = shard_bytes(RecordedEpisode(episode.columns, record))
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
    seed = request.seed
    observation, actions = _started(env, spec, make_expert, request)
    hidden, camera = env.hidden_state(), env.camera_parameters()
    late = bool(len(actions))
    recorder = EpisodeRecorder(env.joints)

    def observe(key_frame: Any) -> None:
        recorder.record(key_frame)
        beat()

    make = functools.partial(_expert, env, spec, make_expert, request)
    if actor is None:
        result = rollout(env, observation, make(late=late), observe, past_success=True)
    else:
        rng = episode_generator(seed, Stream.CORRECTION, category_of(request.object_id))
        correcting = Correcting(actor, functools.partial(make, late=True), spec.expert_share, seed, rng)
        result = corrected_rollout(env, observation, correcting, observe)
    attempt = Attempt(seed, hidden, result.success, result.reason, result.key_frames, late)
    record = _episode_record(env, spec, request, attempt)
    record |= {"start": start_column(actions), "camera": camera}
    return attempt, RecordedEpisode(recorder.columns(), record)


def _episode_record(
    env: SimulatedEnvironment, spec: CollectionSpec, request: EpisodeRequest, attempt: Attempt
) -> dict[str, Any]:
    episode_record = env.episode_record()
    tries = episode_record["try_sequence"]
    return {
        "object_id": request.object_id,
        "seed": attempt.seed,
        "hidden_state": attempt.hidden_state,
        "hidden_overrides": None if request.overrides is None else dict(request.overrides),
        "expert": spec.expert,
        "success": attempt.success,
        "key_frames": attempt.key_frames,
        "task": env.task_description,
        "tries": len(tries),
        "failed_tries": sum(failed for _, _, failed in tries),
        "episode_record": episode_record,
        "versions": {**env.software_versions(), "cpu": cpu_model()},
        "simulation_version": SIMULATION_VERSION,
        "data_version": DATA_VERSION,
    }


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
    return make_expert(
        category_of(request.object_id),
        spec.expert,
        env.annotations,
        trials=spec.trials,
        generator=generator or episode_generator(request.seed, Stream.EXPERT, category_of(request.object_id)),
        hidden=env.hidden_state() if spec.expert == "static" else None,
        strategy=spec.expert_strategy,
        mechanism_rules=spec.environment.mechanism_rules,
        positions=env.part_positions() if late else None,
        feedback=env.feedback if late else None,
        **known,
    )


def _started(
    env: SimulatedEnvironment, spec: CollectionSpec, make_expert: ExpertFactory, request: EpisodeRequest
) -> tuple[Any, NDArray[np.float32]]:
    """Resets, then executes the late start if the seed has one; returns the first observation and the actions."""
    options: dict[str, Any] = {"object_id": request.object_id}
    if request.overrides is not None:
        options["hidden_overrides"] = dict(request.overrides)

    def reset() -> Any:
        return env.reset(seed=request.seed, options=options)[0]

    def driver(generator: np.random.Generator) -> KeyFrames:
        # Always static, so that adaptive and static collections have the same late starts.
        category, hidden = category_of(request.object_id), env.hidden_state()
        return make_expert(category, "static", env.annotations, generator=generator, hidden=hidden)

    start = draw_start(request.seed, category_of(request.object_id), spec.late_starts)
    if start is None:
        return reset(), np.zeros((0, 10), np.float32)
    return start_late(env, start, reset, driver)
