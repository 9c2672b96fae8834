"""Measurements of `adamanip bench`: collection, simulator, observations, training steps, actions."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
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
from lerobot_adamanip.contract.observation import workspace_cloud
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.datasets.dataset import open_dataset
from lerobot_adamanip.episode.options import CLOUD_SOURCES, EnvironmentOptions
from lerobot_adamanip.episode.rollout import next_goal, rollout

SEED = 2025
OBJECTS = 4
STEPS_PER_REPEAT = 20
PRESETS = ("diffusion", "fast")
"""Compared presets of dp3_adaptive."""
Numbers = dict[str, Any]


def median_ms(actions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Returns the median time of each action [ms] after a warm-up. The actions alternate."""
    times: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(1 + repeats):
        for name, action in actions.items():
            begin = time.perf_counter()
            action()
            times[name].append(1e3 * (time.perf_counter() - begin))
    return {name: round(statistics.median(each[1:]), 3) for name, each in times.items()}


def collection(root: Path, category: str, per_object: int, workers: int) -> Numbers:
    """Collects adaptive demonstrations into ``root``. Returns episodes per minute, including simulator start."""
    names = tuple(object_id(category, number) for number in range(OBJECTS))
    environment = EnvironmentOptions(category, observe_images=False)
    spec = CollectionSpec(environment, names, episodes_per_object=per_object, seed=SEED)
    summary = collect(root, spec, factories(), CollectOptions(workers=workers))
    return {
        "episodes": summary.episodes,
        "episodes_per_minute": round(summary.episodes_per_minute, 2),
        "expert_success_rate": round(summary.success_rate, 4),
        "bytes_per_episode": summary.bytes // max(1, summary.episodes),
    }


def simulator(category: str, repeats: int) -> Numbers:
    """Returns control steps and key frames per second, and the time ratio of rendered to ray-cast clouds."""
    from lerobot_env_adamanip.simulator import make_task

    task = make_task(category, objects=object_id(category, 0))
    try:
        task.reset(seed=SEED)
        still = np.zeros(task.action_space.shape, np.float32)
        times = median_ms({"steps": lambda: [task.step(still) for _ in range(STEPS_PER_REPEAT)]}, repeats)
    finally:
        task.close()
    clouds = {source: each["total"] for source, each in observation(category, 5).items()}
    return {
        "steps_per_second": round(1e3 * STEPS_PER_REPEAT / times["steps"], 2),
        "key_frames_per_second": round(_key_frames_per_second(category), 2),
        "rendered_by_cast": round(clouds["render"] / clouds["raycast"], 2),
    }


def _key_frames_per_second(category: str) -> float:
    made, name = factories(), object_id(category, 0)
    env = made.environment(EnvironmentOptions(category, objects=name, observe_images=False))
    try:
        observation, _ = env.reset(seed=SEED, options={"object_id": name})
        expert = made.expert(category, "adaptive", env.annotations, generator=np.random.default_rng(SEED))
        begin = time.perf_counter()
        result = rollout(env, observation, expert)
        return result.key_frames / (time.perf_counter() - begin)
    finally:
        env.close()


def observation(category: str, repeats: int) -> dict[str, dict[str, float]]:
    """Returns cloud source -> median observation time after an expert's key frame [ms]."""
    from lerobot_env_adamanip.simulator import make_task

    result = {}
    for source in CLOUD_SOURCES:
        task = make_task(category, objects=object_id(category, 0), cloud_source=source)
        try:
            result[source] = {"total": _observation_ms(task, repeats)}
        finally:
            task.close()
    return result


def _observation_ms(task: Any, repeats: int) -> float:
    times: list[float] = []
    while len(times) <= repeats:
        task.reset(seed=SEED)
        generator = np.random.default_rng(SEED)
        expert = factories().expert(task.category, "adaptive", task.placement.annotations, generator=generator)
        goal = next(expert, None)
        while goal is not None:
            felt = task.execute(goal.action())
            begin = time.perf_counter()
            workspace_cloud(task.cameras.points(), Workspace(), DEFAULT_NUM_POINTS)
            times.append(1e3 * (time.perf_counter() - begin))
            goal = next_goal(expert, felt)
    return round(statistics.median(times[1:]), 3)


class Policies:
    """Measures dp3_adaptive's presets on a dataset.

    Args:
        root: folder of the dataset, read at the first measurement.
        batch_size: batch size of a training step.
        device: device of the policies.
    """

    def __init__(self, root: Path, batch_size: int, device: str) -> None:
        self.root, self.batch_size, self.device = root, batch_size, device

    def training(self, repeats: int) -> Numbers:
        """Returns preset -> time of a training step [ms]."""
        times = median_ms({preset: self._step(preset) for preset in PRESETS}, repeats)
        return {preset: {"ms": {"total": times[preset]}} for preset in PRESETS}

    def action(self, repeats: int) -> Numbers:
        """Returns preset -> time of an action [ms] in one environment and in ten."""
        actors = {preset: self._actor(preset) for preset in PRESETS}
        sizes = {f"batch_{size}": size for size in (1, 10)}
        times = {
            name: median_ms({preset: partial(act, size) for preset, act in actors.items()}, repeats)
            for name, size in sizes.items()
        }
        return {preset: {name: times[name][preset] for name in sizes} for preset in PRESETS}

    def _policy(self, preset: str) -> tuple[Any, Any, Any, Any]:
        """Returns policy, preprocessor, postprocessor and dataset as created by lerobot-train."""
        from lerobot_policy_adamanip import DP3AdaptiveConfig
        from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import Inference

        meta = LeRobotDatasetMetadata(f"local/{self.root.name}", root=self.root)
        # One draw: an untrained policy would reject most of its draws, a trained one rejects one of 25 (doors).
        config = DP3AdaptiveConfig(preset=preset, device=self.device, inference=Inference(redraw=False))
        policy = make_policy(config, ds_meta=meta)
        processors = make_pre_post_processors(config, dataset_stats=meta.stats)
        return policy, *processors, open_dataset(self.root, delta_timestamps=resolve_delta_timestamps(config, meta))

    def _step(self, preset: str) -> Callable[[], None]:
        policy, before, _, dataset = self._policy(preset)
        policy.train()
        settings = policy.config.get_optimizer_preset()
        optimizer = settings.build(policy.get_optim_params())
        rows = RandomSampler(dataset, replacement=True, num_samples=2**20)
        batches = iter(DataLoader(dataset, self.batch_size, sampler=rows))

        def step() -> None:
            policy.forward(before(next(batches)))[0].backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), settings.grad_clip_norm)
            optimizer.step()
            optimizer.zero_grad()
            policy.update()
            self._synchronize()

        return step

    def _actor(self, preset: str) -> Callable[[int], None]:
        policy, before, after, dataset = self._policy(preset)
        policy.eval()
        item = dataset[0]

        def act(size: int) -> None:
            latest = {
                key: item[key][-1] if f"{key}_is_pad" in item else item[key] for key in policy.config.input_features
            }
            observation = {key: value.unsqueeze(0).repeat(size, *(1,) * value.dim()) for key, value in latest.items()}
            policy.reset()
            with torch.inference_mode():
                after(policy.select_action(before(observation)))
            self._synchronize()

        return act

    def _synchronize(self) -> None:
        if self.device == "cuda":
            torch.cuda.synchronize()
