"""Uses of the code, each seen as the way that it takes through our files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from ways import Way, traced


def step_in_mid_episode() -> Way:
    """One `env.step`: the adaptive expert's hand pulls at the locked door of a safe."""
    from lerobot_adamanip.experts import Phase, make_expert
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    env = KeyframeEnv("safe", objects="safe_000", num_points=128, observe_images=False)
    try:
        env.reset(seed=0, options={"hidden_overrides": {"locked": True}})
        expert = make_expert("safe", "adaptive", env.annotations, generator=np.random.default_rng(0))
        goal = next(expert)
        while goal.phase in (Phase.APPROACH, Phase.GRASP):
            env.step(goal.action())
            goal = expert.send(env.feedback)
        action = goal.action()
        with traced() as way:
            _, _, terminated, truncated, _ = env.step(action)
        assert not terminated
        assert not truncated
        return way
    finally:
        env.close()


def collected_episode() -> Way:
    """`collect` from an empty folder to a dataset of one microwave, in this process."""
    from demos_helpers import InThisProcess

    from lerobot_adamanip.collection.collect import collect
    from lerobot_adamanip.collection.record import Factories
    from lerobot_adamanip.datasets.collection_spec import CollectionSpec
    from lerobot_adamanip.episode.options import EnvironmentOptions
    from lerobot_adamanip.experts import make_expert
    from lerobot_adamanip.util import jobs
    from lerobot_env_adamanip.make_environment import make_environment

    environment = EnvironmentOptions("microwave", objects="microwave_000", num_points=128, observe_images=False)
    spec = CollectionSpec(environment, ("microwave_000",), episodes_per_object=1)
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "WorkerPool", InThisProcess)
        collect(Path(folder) / "first", spec, Factories(make_environment, make_expert))  # fills the caches
        with traced() as way:
            summary = collect(Path(folder) / "dataset", spec, Factories(make_environment, make_expert))
    assert summary.episodes == 1
    return way


def reported_episode() -> Way:
    """An episode's record to the log, and to a row of `adamanip report`."""
    from records import record

    from lerobot_adamanip.evaluation.record import append_record, read_log
    from lerobot_adamanip.evaluation.report import compare

    episode = record()
    with tempfile.TemporaryDirectory() as folder, traced() as way:
        append_record(Path(folder) / "log.jsonl", episode)
        table = compare({"log": read_log(Path(folder) / "log.jsonl")}).table()
    assert "100" in table
    return way
