"""Measures collection, simulation, observation, training and action on this machine: ``python scripts/bench.py``.

Prints medians of several repeats after a warm-up as JSON, and progress on stderr. Compared items are measured
alternately, so ratios also hold on a busy machine; times do not.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import logging
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
from lerobot.policies.factory import make_policy, make_pre_post_processors
from torch.utils.data import DataLoader, RandomSampler

from lerobot_adamanip.catalog import object_id
from lerobot_adamanip.cli.collect import factories
from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.contract.cameras import CAMERAS
from lerobot_adamanip.contract.control import DENSE
from lerobot_adamanip.contract.observation import workspace_cloud
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.datasets.dataset import open_dataset
from lerobot_adamanip.episode.dense import dense_rollout
from lerobot_adamanip.episode.options import CLOUD_SOURCES, EnvironmentOptions
from lerobot_adamanip.episode.rollout import next_goal
from lerobot_adamanip.evaluation.provenance import machine_class, present_origin
from lerobot_env_adamanip.dense_env import DenseEnv
from lerobot_env_adamanip.sim.render_device import can_render
from lerobot_env_adamanip.simulator import make_task
from lerobot_policy_adamanip import DP3AdaptiveConfig

CATEGORY, OBJECTS, SEED = "safe", 4, 2025
IMAGE_PIXELS = 128
"""Side length of measured images."""
WORKERS, BATCH_SIZE, STEPS_PER_REPEAT, TICKS = 2, 64, 20, 100
PICTURES: dict[str, dict[str, Any]] = {
    "without_pictures": {"observe_images": False},
    "with_pictures": {"observe_images": True, "image_size": IMAGE_PIXELS},
}
"""Environments at control rate; the second with two cameras."""
PRESETS = ("dp3", "keyframe")
"""Compared presets of dp3_adaptive."""
LIMITS = {
    "episodes_per_minute": ("at least", 8.0),
    "observation_ms.raycast": ("at most", 15.0),
    "image_ms.raycast.front": ("at most", 15.0),
    "image_ms.raycast.wrist": ("at most", 15.0),
    "training_ms.keyframe": ("at most", 60.0),
    "action_ms.keyframe.batch_1": ("at most", 5.0),
    "dense.collected_per_minute.without_pictures": ("at least", 60.0),
    "dense.collected_per_minute.with_pictures": ("at least", 20.0),
    "dense.driven_per_minute.without_pictures": ("at least", 40.0),
    "dense.driven_per_minute.with_pictures": ("at least", 15.0),
}
"""Expected values on two CPU cores without a GPU."""


def median_ms(actions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Returns the median time of each action [ms] after a warm-up. The actions alternate."""
    times: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(1 + repeats):
        for name, action in actions.items():
            begin = time.perf_counter()
            action()
            times[name].append(1e3 * (time.perf_counter() - begin))
    return {name: round(statistics.median(series[1:]), 3) for name, series in times.items()}


def collect_demonstrations(root: Path, per_object: int, environment: EnvironmentOptions) -> dict[str, float]:
    """Collects adaptive demonstrations into ``root``, including the start of the simulators."""
    names = tuple(object_id(CATEGORY, number) for number in range(OBJECTS))
    spec = CollectionSpec(environment, names, episodes_per_object=per_object, seed=SEED)
    summary = collect(root, spec, factories(), CollectOptions(workers=WORKERS))
    return {
        "episodes_per_minute": round(summary.episodes_per_minute, 2),
        "expert_success_rate": round(summary.success_rate, 4),
        "bytes_per_episode": summary.bytes // max(1, summary.episodes),
    }


def dense_rates(root: Path, per_object: int, repeats: int) -> dict[str, float]:
    """Returns rates at control rate: ticks a second of the simulator alone, and episodes a minute.

    Episodes are collected by `WORKERS` processes, with their start, or driven by the expert in one environment.
    """
    rates: dict[str, float] = {}
    for name, options in PICTURES.items():
        environment = EnvironmentOptions(CATEGORY, object_id(CATEGORY, 0), control=DENSE, **options)
        collected = collect_demonstrations(root / name, per_object, environment)
        rates[f"collected_per_minute.{name}"] = collected["episodes_per_minute"]
        with contextlib.closing(DenseEnv(options=environment)) as env:
            env.reset(seed=SEED)
            begin = time.perf_counter()
            for seed in range(repeats):
                observation, _ = env.reset(seed=seed)
                generator = np.random.default_rng(seed)
                expert = factories().expert(CATEGORY, "adaptive", env.annotations, generator=generator)
                dense_rollout(env, observation, expert)
            rates[f"driven_per_minute.{name}"] = round(60 * repeats / (time.perf_counter() - begin), 2)
            ticks = median_ms({"ticks": lambda: [env.episode.task.driver.stream_tick() for _ in range(TICKS)]}, repeats)
            rates["ticks_per_second"] = round(1e3 * TICKS / ticks["ticks"], 2)
    return rates


def steps_per_second(repeats: int) -> float:
    """Returns control steps per second."""
    with contextlib.closing(make_task(CATEGORY, objects=object_id(CATEGORY, 0))) as task:
        task.reset(seed=SEED)
        still = np.zeros(task.action_space.shape, np.float32)
        times = median_ms({"steps": lambda: [task.step(still) for _ in range(STEPS_PER_REPEAT)]}, repeats)
    return round(1e3 * STEPS_PER_REPEAT / times["steps"], 2)


def observation_ms(source: str, repeats: int) -> float:
    """Returns the median time of an observation after an expert's key frame [ms], for a source of clouds."""
    times: list[float] = []
    with contextlib.closing(make_task(CATEGORY, objects=object_id(CATEGORY, 0), cloud_source=source)) as task:
        while len(times) <= repeats:
            task.reset(seed=SEED)
            generator = np.random.default_rng(SEED)
            expert = factories().expert(CATEGORY, "adaptive", task.placement.annotations, generator=generator)
            goal = next(expert, None)
            while goal is not None:
                feedback = task.execute(goal.action())
                begin = time.perf_counter()
                workspace_cloud(task.cameras.points(), Workspace(), DEFAULT_NUM_POINTS)
                times.append(1e3 * (time.perf_counter() - begin))
                goal = next_goal(expert, feedback)
    return round(statistics.median(times[1:]), 3)


def image_ms(repeats: int) -> dict[str, float]:
    """Returns the median time of an image of `IMAGE_PIXELS` per source and camera [ms], with the hand at the part.

    ``times_as_fast`` is the ratio of both sources over both cameras. Without a renderer there is ray casting alone.
    """
    options = EnvironmentOptions(CATEGORY, object_id(CATEGORY, 0), image_size=IMAGE_PIXELS)
    with contextlib.closing(make_task(CATEGORY, options=options, shader="minimal")) as task:
        task.reset(seed=SEED)
        expert = factories().expert(CATEGORY, "adaptive", task.placement.annotations, generator=np.random.default_rng())
        task.execute(next(expert).action())
        draw: dict[str, Callable[[str], object]] = {"raycast": task.cameras.raycast_image}
        if can_render():
            draw["render"] = task.cameras.rendered_image
        times = median_ms(
            {f"{source}.{name}": functools.partial(take, name) for source, take in draw.items() for name in CAMERAS},
            repeats,
        )
    sums = [sum(times[f"{source}.{name}"] for name in CAMERAS) for source in draw]
    return times if len(sums) == 1 else {**times, "times_as_fast": round(sums[1] / sums[0], 2)}


def policies(root: Path, device: str, repeats: int) -> dict[str, Any]:
    """Returns the times of a training step and of an action, in one environment and in ten, per preset [ms]."""
    created = {preset: create_policy(root, preset, device) for preset in PRESETS}
    steps = median_ms({preset: training_step(device, parts) for preset, parts in created.items()}, repeats)
    actions = {
        f"{preset}.batch_{size}": action(device, size, parts) for preset, parts in created.items() for size in (1, 10)
    }
    return {"training_ms": steps, "action_ms": median_ms(actions, 3 * repeats)}


def create_policy(root: Path, preset: str, device: str) -> tuple[Any, Any, Any, Any]:
    """Returns policy, preprocessor, postprocessor and dataset as created by lerobot-train."""
    meta = LeRobotDatasetMetadata(f"local/{root.name}", root=root)
    config = DP3AdaptiveConfig(preset=preset, device=device)
    dataset = open_dataset(root, delta_timestamps=resolve_delta_timestamps(config, meta))
    policy = make_policy(config, ds_meta=dataset.meta)  # as lerobot-train: of the dataset that is read
    return policy, *make_pre_post_processors(config, dataset_stats=meta.stats), dataset


def training_step(device: str, parts: tuple[Any, Any, Any, Any]) -> Callable[[], None]:
    """Returns a function that trains the policy with one batch."""
    policy, before, _, dataset = parts
    settings = policy.config.get_optimizer_preset()
    optimizer = settings.build(policy.get_optim_params())
    batches = iter(DataLoader(dataset, BATCH_SIZE, sampler=RandomSampler(dataset, replacement=True, num_samples=2**20)))

    def step() -> None:
        policy.train()
        policy.forward(before(next(batches)))[0].backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), settings.grad_clip_norm)
        optimizer.step()
        optimizer.zero_grad()
        policy.update()
        synchronize(device)

    return step


def action(device: str, size: int, parts: tuple[Any, Any, Any, Any]) -> Callable[[], None]:
    """Returns a function that computes a first action for ``size`` environments."""
    policy, before, after, dataset = parts
    item = dataset[0]
    latest = {key: item[key][-1] if f"{key}_is_pad" in item else item[key] for key in policy.config.input_features}
    observation = {key: value.unsqueeze(0).repeat(size, *(1,) * value.dim()) for key, value in latest.items()}

    def act() -> None:
        policy.eval()
        policy.reset()
        with torch.inference_mode():
            after(policy.select_action(before(observation)))
        synchronize(device)

    return act


def synchronize(device: str) -> None:
    """Waits for the GPU."""
    if device == "cuda":
        torch.cuda.synchronize()


def measure(device: str, quick: bool) -> dict[str, Any]:
    """Returns all measurements, and whether each limit holds."""
    begin, repeats = time.monotonic(), 3 if quick else 7
    machine = {**machine_class(), "load": round(os.getloadavg()[0], 2), "torch_threads": torch.get_num_threads()}
    results: dict[str, Any] = {"commit": present_origin().commit, "machine": machine}
    with tempfile.TemporaryDirectory(prefix="adamanip-bench-") as folder:
        root = Path(folder) / "demos"
        parts: tuple[Callable[[], dict[str, Any]], ...] = (
            lambda: collect_demonstrations(root, 1 if quick else 2, EnvironmentOptions(CATEGORY, observe_images=False)),
            lambda: {"dense": dense_rates(Path(folder), 1 if quick else 25, repeats)},
            lambda: {"steps_per_second": steps_per_second(3 * repeats)},
            lambda: {"observation_ms": {source: observation_ms(source, 3 * repeats) for source in CLOUD_SOURCES}},
            lambda: {"image_ms": image_ms(9 * repeats)},
            lambda: policies(root, device, repeats),
        )
        for part in parts:
            results |= part()
            sys.stderr.write(f"[{time.monotonic() - begin:5.0f} s] {', '.join(results)}\n")
    values = {
        "episodes_per_minute": results["episodes_per_minute"],
        "observation_ms.raycast": results["observation_ms"]["raycast"],
        **{f"image_ms.raycast.{name}": results["image_ms"][f"raycast.{name}"] for name in CAMERAS},
        "training_ms.keyframe": results["training_ms"]["keyframe"],
        "action_ms.keyframe.batch_1": results["action_ms"]["keyframe.batch_1"],
        **{f"dense.{name}": rate for name, rate in results["dense"].items()},
    }
    results["limits"] = {
        name: {
            "value": values[name],
            "limit": f"{side} {bound:g}",
            "ok": values[name] >= bound if side == "at least" else values[name] <= bound,
        }
        for name, (side, bound) in LIMITS.items()
    }
    return results


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer episodes and repeats")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="device of the policies")
    options = parser.parse_args()
    logging.getLogger().setLevel(logging.ERROR)
    with contextlib.redirect_stdout(sys.stderr):
        measured = measure(options.device, options.quick)
    sys.stdout.write(json.dumps(measured, indent=2) + "\n")
