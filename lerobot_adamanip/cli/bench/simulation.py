"""What the benchmark measures with the simulator: collection, steps, key frames, observations."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.catalog import object_id
from lerobot_adamanip.cli.bench.timing import Stopwatch, per_second, ratio, repeat_ms
from lerobot_adamanip.cli.collect import factories
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.demos.collect import CollectOptions, collect
from lerobot_adamanip.demos.collection import CollectionSpec
from lerobot_adamanip.observation import workspace_cloud
from lerobot_adamanip.options import EnvironmentOptions
from lerobot_adamanip.pointcloud import Workspace
from lerobot_adamanip.rollout import rollout
from lerobot_adamanip.schema import DEFAULT_NUM_POINTS, PAPER_NUM_POINTS

STEPS_PER_REPEAT = 20
SEED = 20_25


def collection(root: Path, *, category: str, objects: int, per_object: int, workers: int) -> dict[str, Any]:
    """Collects adaptive demonstrations into ``root``.

    Returns episodes, workers, episodes per minute (as `adamanip collect` reports it, starting the simulators included;
    and steadily, from the first finished episode to the last), the expert's success and bytes per episode.
    """
    names = tuple(object_id(category, number) for number in range(objects))
    finished: list[float] = []

    spec = CollectionSpec(EnvironmentOptions(category), names, episodes_per_object=per_object, seed=SEED)
    with show_progress({"record": "episodes", "assemble": "writing the dataset"}) as progress:

        def listen(stage: str, done: int, total: int) -> None:
            progress(stage, done, total)
            if stage == "record" and done:
                finished.append(time.monotonic())

        summary = collect(root, spec, factories(), CollectOptions(workers=workers), listen)
    # The first finished episode of each worker starts its clock.
    counted, span = len(finished) - workers, finished[-1] - finished[min(workers, len(finished)) - 1]
    return {
        "episodes": summary.episodes,
        "workers": workers,
        "episodes_per_minute": round(summary.episodes_per_minute, 2),
        "episodes_per_minute_steady": round(60 * counted / span, 2) if counted > 0 and span > 0 else None,
        "expert_success_rate": round(summary.expert_success_rate, 4),
        "bytes_per_episode": summary.bytes // max(1, summary.episodes),
    }


def simulation(*, category: str, repeats: int) -> tuple[dict[str, float], dict[str, float]]:
    """Returns rates of the simulator [1/s], and times of an observation by stage [ms], of one environment."""
    from lerobot_env_adamanip.keyframe_env import make_task

    name = object_id(category, 0)
    key_frame = _key_frame_ms(category, name)
    task = make_task(category, objects=name)
    try:
        task.reset(seed=SEED)
        return _rates(task, key_frame, repeats), _observation(task, repeats)
    finally:
        task.close()


def _rates(task: Any, key_frame_ms: float, repeats: int) -> dict[str, float]:
    still = np.zeros(task.action_space.shape, np.float32)
    workspace = Workspace()

    def step() -> None:
        for _ in range(STEPS_PER_REPEAT):
            task.step(still)

    def step_and_look() -> None:
        task.step(still)
        workspace_cloud(task.observe().points_in_base, workspace, DEFAULT_NUM_POINTS)

    plain = per_second(repeat_ms(step, repeats) / STEPS_PER_REPEAT)
    seen = per_second(repeat_ms(step_and_look, repeats))
    return {
        "steps_per_second": plain,
        "steps_per_second_with_cloud": seen,
        "cloud_slowdown": ratio(plain, seen),
        "key_frames_per_second": per_second(key_frame_ms),
    }


def _key_frame_ms(category: str, name: str) -> float:
    """Times the key frames of one expert's episode, observation included; returns their mean [ms]."""
    made = factories()
    env = made.environment(EnvironmentOptions(category, objects=name))
    try:
        observation, _ = env.reset(seed=SEED, options={"object_id": name})
        expert = made.expert(category, "adaptive", env.annotations, generator=np.random.default_rng(SEED))
        begin = time.perf_counter()
        result = rollout(env, observation, expert)
        seconds = time.perf_counter() - begin
    finally:
        env.close()
    # A mean: key frames differ in length, and their sum is what an episode takes.
    return 1e3 * seconds / result.key_frames


def _observation(task: Any, repeats: int) -> dict[str, float]:
    watch, workspace = Stopwatch(), Workspace()
    for _ in range(1 + repeats):
        with watch.stage("total"):
            with watch.stage("render"):
                points = task.observe().points_in_base
            with watch.stage(f"crop_fps_{DEFAULT_NUM_POINTS}"):
                workspace_cloud(points, workspace, DEFAULT_NUM_POINTS)
        with watch.stage(f"crop_fps_{PAPER_NUM_POINTS}"):
            workspace_cloud(points, workspace, PAPER_NUM_POINTS)
    return watch.medians_ms()
