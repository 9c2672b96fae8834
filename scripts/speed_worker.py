"""Measures one version of the code, asked line by line: the other end of `bench_against.py`.

Runs under the version that is first on PYTHONPATH, so it uses only what both have. A request is a line of JSON on
standard input, ``{"do": "open", "category": "safe"}`` or ``{"do": "measure", "seeds": [1, 2]}``, and so is its answer
on standard output.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np


class Clock:
    """Adds up processor time of named functions, all threads together [s], and counts their calls."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.calls: dict[str, int] = {}

    def watch(self, owner: Any, name: str, label: str) -> None:
        """Times ``owner.name`` from now on."""
        plain = getattr(owner, name)

        def timed(*args: Any, **values: Any) -> Any:
            with self.running(label):
                return plain(*args, **values)

        setattr(owner, name, timed)

    @contextlib.contextmanager
    def running(self, label: str) -> Iterator[None]:
        """Times what happens inside."""
        begin = time.process_time()
        try:
            yield
        finally:
            self.seconds[label] = self.seconds.get(label, 0.0) + time.process_time() - begin
            self.calls[label] = self.calls.get(label, 0) + 1

    def clear(self) -> None:
        """Starts anew."""
        self.seconds.clear()
        self.calls.clear()


class Stepped:
    """A physics system whose steps are timed; the rest is the system's own."""

    def __init__(self, system: Any, clock: Clock) -> None:
        self._system, self._clock = system, clock

    def __getattr__(self, name: str) -> Any:
        return getattr(self._system, name)

    def step(self) -> None:
        """One physics step."""
        with self._clock.running("physics"):
            self._system.step()


class Measured:
    """One environment of this version, its clouds and nothing else.

    Args:
        clock: that is read.
        detail: whether to time what a control tick is made of, too, which costs time itself.
    """

    def __init__(self, clock: Clock, *, detail: bool) -> None:
        from lerobot_env_adamanip.keyframe_env import KeyframeEnv
        from lerobot_env_adamanip.sim.tasks.base import AdaManipTask

        self.env: Any = None
        self._clock, self._detail = clock, detail
        for name in ("execute", "observe", "reset", "_tick"):
            clock.watch(AdaManipTask, name, name)
        clock.watch(KeyframeEnv, "observe" if hasattr(KeyframeEnv, "observe") else "_observe", "cloud")
        if detail:
            self._watch_parts()

    def _watch_parts(self) -> None:
        from lerobot_env_adamanip.sim.keyframe_driver import KeyframeDriver
        from lerobot_env_adamanip.sim.kinematics import ArmKinematics
        from lerobot_env_adamanip.sim.mechanism_driver import MechanismDriver

        self._clock.watch(ArmKinematics, "solve", "inverse kinematics")
        self._clock.watch(MechanismDriver, "apply", "mechanism")
        if hasattr(KeyframeDriver, "_lags"):
            self._clock.watch(KeyframeDriver, "_lags", "lag")

    def open(self, category: str) -> dict[str, Any]:
        """Makes the environment of a category, and an episode to warm it up."""
        from lerobot_adamanip.episode.options import EnvironmentOptions
        from lerobot_env_adamanip.make_env import make_keyframe_env

        if self.env is not None:
            self.env.close()
        self.category = category
        self.env = make_keyframe_env(EnvironmentOptions(category=category, split="validation", observe_images=False))
        self.episode(0)
        return {"category": category}

    def measure(self, seeds: list[int]) -> dict[str, Any]:
        """Runs an expert's episodes. Returns times [s] and counts, with those of parts."""
        self._clock.clear()
        begin, wall = time.process_time(), time.perf_counter()
        successes = sum(self.episode(seed) for seed in seeds)
        return {
            "cpu": time.process_time() - begin,
            "wall": time.perf_counter() - wall,
            "seconds": dict(self._clock.seconds),
            "calls": dict(self._clock.calls),
            "successes": successes,
        }

    def episode(self, seed: int) -> bool:
        """Runs one episode of the adaptive expert; True if it succeeds."""
        from lerobot_adamanip.episode.rollout import rollout
        from lerobot_adamanip.experts import make_expert

        observation, _ = self.env.reset(seed=seed)
        self._time_physics()
        expert = make_expert(self.category, "adaptive", self.env.annotations, generator=np.random.default_rng(seed))
        return bool(rollout(self.env, observation, expert).success)

    def _time_physics(self) -> None:
        tick = getattr(self.env._sim, "_control_tick", None)
        if not self._detail:
            return
        if tick is not None:
            tick._system = Stepped(tick._system, self._clock)
        else:
            scene = self.env._sim.scene
            scene.px = Stepped(scene.px, self._clock)


def serve(measured: Measured) -> None:
    """Answers requests until there are no more."""
    actions: dict[str, Callable[..., dict[str, Any]]] = {"open": measured.open, "measure": measured.measure}
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print must not get among the answers
    for line in sys.stdin:
        request = json.loads(line)
        answers.write(json.dumps(actions[request.pop("do")](**request)) + "\n")
        answers.flush()


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    serve(Measured(Clock(), detail="--detail" in sys.argv))
