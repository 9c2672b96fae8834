"""The process that owns a simulator: takes work items, records episodes, writes each one durably."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import platform
import signal
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.demos.collection import CollectionSpec, EpisodeSpec, episode_seed
from lerobot_adamanip.demos.recorder import EpisodeRecorder
from lerobot_adamanip.demos.shards import RecordedEpisode, write_shard
from lerobot_adamanip.errors import AdaManipError, ConfigurationError, UnreachableError
from lerobot_adamanip.rollout import KeyframeEnvironment, RolloutResult, rollout

_VERSIONED = ("lerobot_env_adamanip", "lerobot", "mani_skill", "sapien", "numpy", "torch")
_EXPERT_STREAM = 1
"""Tells the expert's random stream from any other that starts from the episode's seed."""


@dataclass(frozen=True)
class Report:
    """What a worker tells of an item: recorded (then ``key_frames`` counts), or given up; or an error that ends it all.

    Attributes:
        item: which; None if the worker failed before it had one.
        recorded: whether an episode file was written.
        attempts: episodes tried.
        key_frames: of the recorded episode.
        failures: per failed attempt: seed and reason.
        seconds: it took.
        error: text of an error that no other episode would survive.
    """

    item: EpisodeSpec | None
    recorded: bool = False
    attempts: int = 0
    key_frames: int = 0
    failures: tuple[dict[str, Any], ...] = field(default=())
    seconds: float = 0.0
    error: str | None = None


def resolve(path: str) -> Callable[..., Any]:
    """Returns the function that ``module:function`` names."""
    module, _, name = path.partition(":")
    try:
        function: Callable[..., Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigurationError(
            f"Cannot import a factory: {error}.",
            got=path,
            allowed="module:function",
            hint="adamanip doctor, which shows what is not installed",
        ) from error
    return function


def make_env(options: CollectionSpec, object_id: str) -> KeyframeEnvironment:
    """Builds the environment of a collection in which an object can be worked on."""
    factory, category = resolve(options.env_factory), options.category_of(object_id)
    env: KeyframeEnvironment = factory(
        category, options.num_points, image_size=options.image_size, **options.env_options
    )
    return env


def versions() -> dict[str, str]:
    """Returns the versions of whatever decides how an episode comes out."""
    found = {"python": platform.python_version()}
    for name in _VERSIONED:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def attempt_episode(
    env: KeyframeEnvironment, options: CollectionSpec, object_id: str, seed: int
) -> tuple[RolloutResult, RecordedEpisode]:
    """Records one episode, successful or not."""
    observation, _ = env.reset(seed=seed, options={"object_id": object_id})
    hidden, camera = env.hidden_state(), env.camera_parameters()
    expert = resolve(options.expert_factory)(
        options.category_of(object_id),
        options.expert,
        env.annotations,
        trials=options.trials,
        generator=np.random.default_rng([seed, _EXPERT_STREAM]),
        hidden=hidden if options.expert == "static" else None,
        **options.expert_options,
    )
    recorder = EpisodeRecorder()
    result = rollout(env, observation, expert, recorder.record)
    record = {
        "object_id": object_id,
        "seed": seed,
        "hidden_state": hidden,
        "expert": options.expert,
        "trials": recorder.trials,
        "success": result.success,
        "camera": camera,
        "task": env.task_description,
        "episode_record": env.episode_record(),
        "versions": versions(),
    }
    return result, RecordedEpisode(recorder.columns(), record)


def record_item(
    env: KeyframeEnvironment, options: CollectionSpec, item: EpisodeSpec, folder: Path, max_attempts: int
) -> Report:
    """Tries seeds until the expert succeeds, and writes that episode."""
    failures: list[dict[str, Any]] = []
    for attempt in range(max_attempts):
        category = options.category_of(item.object_id)
        seed = episode_seed(options.seed, category, item.object_id, item.slot, attempt)
        try:
            result, episode = attempt_episode(env, options, item.object_id, seed)
        except UnreachableError as error:
            failures.append({"seed": seed, "reason": f"unreachable: {error}"})
            continue
        if not result.success:
            failures.append({"seed": seed, "reason": result.reason})
            continue
        record = {**episode.record, "slot": item.slot, "attempts": attempt + 1, "failures": failures}
        write_shard(folder / item.file_name, RecordedEpisode(episode.columns, record))
        return Report(item, True, attempt + 1, len(episode), tuple(failures))
    return Report(item, False, max_attempts, 0, tuple(failures))


def worker_main(pipe: Connection, options: dict[str, Any], folder: str, max_attempts: int) -> None:
    """Serves items from ``pipe`` until it closes; builds its simulator with the first one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides what it means
    threading.Thread(target=_die_with_parent, daemon=True).start()
    wanted = CollectionSpec.from_json(options)
    env: KeyframeEnvironment | None = None
    item: EpisodeSpec | None = None
    category = ""
    try:
        while True:
            item = EpisodeSpec(**pipe.recv())
            begin = time.monotonic()
            if env is None or category != wanted.category_of(item.object_id):
                if env is not None:
                    env.close()  # one simulator at a time
                category, env = wanted.category_of(item.object_id), make_env(wanted, item.object_id)
            report = record_item(env, wanted, item, Path(folder), max_attempts)
            pipe.send(asdict(replace(report, seconds=time.monotonic() - begin)))
    except (EOFError, BrokenPipeError):
        pass
    except Exception as error:  # the parent shows it: a worker has no screen of its own
        text = str(error) if isinstance(error, AdaManipError) else traceback.format_exc()
        pipe.send(asdict(Report(item, error=text)))
    finally:
        if env is not None:
            env.close()


def _die_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
