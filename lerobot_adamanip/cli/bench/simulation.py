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
from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.contract.observation import workspace_cloud
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, PAPER_NUM_POINTS
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.episode.options import CLOUD_SOURCES, EnvironmentOptions
from lerobot_adamanip.episode.rollout import next_goal, rollout

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
        "expert_success_rate": round(summary.success_rate, 4),
        "bytes_per_episode": summary.bytes // max(1, summary.episodes),
    }


def simulation(*, category: str, repeats: int) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Returns rates of the simulator [1/s], and times of an observation by source of the cloud and stage [ms].

    ``rendered_by_cast``: how many times longer the whole observation takes rendered, in this run.
    """
    from lerobot_env_adamanip.keyframe_env import make_task

    name = object_id(category, 0)
    key_frame = _key_frame_ms(category, name)
    sources: dict[str, dict[str, float]] = {}
    rates: dict[str, float] = {}
    for source in CLOUD_SOURCES:
        task = make_task(category, objects=name, cloud_source=source)
        try:
            task.reset(seed=SEED)
            sources[source] = _observation(task, repeats)
            rates = rates or _rates(task, key_frame, repeats)
        finally:
            task.close()
    rates["rendered_by_cast"] = ratio(sources["render"]["total"], sources["raycast"]["total"])
    return rates, sources


def _rates(task: Any, key_frame_ms: float, repeats: int) -> dict[str, float]:
    still = np.zeros(task.action_space.shape, np.float32)
    workspace = Workspace()

    def step() -> None:
        for _ in range(STEPS_PER_REPEAT):
            task.step(still)

    def step_and_look() -> None:
        task.step(still)
        workspace_cloud(task.observe(image=False).points_in_base, workspace, DEFAULT_NUM_POINTS)

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
    """Times what is observed after each key frame of an expert: medians over at least ``repeats`` of them [ms]."""
    watch, workspace = Stopwatch(), Workspace()
    seen = 0
    while seen <= repeats:
        task.reset(seed=SEED)
        generator = np.random.default_rng(SEED)
        expert = factories().expert(task.category, "adaptive", task.placement.annotations, generator=generator)
        goal = next(expert, None)
        while goal is not None:
            felt = task.execute(goal.action())
            seen += 1
            with watch.stage("total"):
                with watch.stage("points"):
                    points = task.observe(image=False).points_in_base
                with watch.stage(f"crop_fps_{DEFAULT_NUM_POINTS}"):
                    workspace_cloud(points, workspace, DEFAULT_NUM_POINTS)
            with watch.stage(f"crop_fps_{PAPER_NUM_POINTS}"):
                workspace_cloud(points, workspace, PAPER_NUM_POINTS)
            goal = next_goal(expert, felt)
    return watch.medians_ms()
