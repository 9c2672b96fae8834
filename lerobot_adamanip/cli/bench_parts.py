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
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_adamanip.catalog import object_id
from lerobot_adamanip.cli.collect import factories
from lerobot_adamanip.collection.collect import CollectOptions, collect
from lerobot_adamanip.contract.observation import workspace_cloud
from lerobot_adamanip.contract.pointcloud import Workspace, as_points
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS, POINT_CLOUD
from lerobot_adamanip.datasets.collection_spec import CollectionSpec
from lerobot_adamanip.datasets.reading import open_dataset
from lerobot_adamanip.episode.options import CLOUD_SOURCES, EnvironmentOptions
from lerobot_adamanip.episode.rollout import next_goal, rollout

SEED = 2025
OBJECTS = 4
STEPS_PER_REPEAT = 20
BEFORE, NOW = "diffusion", "fast"
"""Presets that are compared: the default of 0.1, and today's."""
Numbers = dict[str, Any]


def median_ms(action: Callable[[], object], repeats: int) -> float:
    """Returns the median time of an action [ms] over repeats, after a warm-up."""
    return compare_ms({"it": action}, repeats)["it"]


def compare_ms(actions: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Returns the median time of each action [ms]; they take turns, so that a busy machine slows all of them."""
    times: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(1 + repeats):
        for name, action in actions.items():
            begin = time.perf_counter()
            action()
            times[name].append(1e3 * (time.perf_counter() - begin))
    return {name: round(statistics.median(each[1:]), 3) for name, each in times.items()}


def collection(root: Path, category: str, *, per_object: int, workers: int) -> Numbers:
    """Collects adaptive demonstrations into ``root``; returns episodes per minute, starting the simulators included."""
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
    """Returns control steps and key frames per second, and how many times longer a rendered cloud takes than a cast."""
    from lerobot_env_adamanip.simulator import make_task

    task = make_task(category, objects=object_id(category, 0))
    try:
        task.reset(seed=SEED)
        still = np.zeros(task.action_space.shape, np.float32)
        step = median_ms(lambda: [task.step(still) for _ in range(STEPS_PER_REPEAT)], repeats) / STEPS_PER_REPEAT
    finally:
        task.close()
    clouds = {source: observation(category, 5)[source]["total"] for source in CLOUD_SOURCES}
    return {
        "steps_per_second": round(1e3 / step, 2),
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
    """Returns source of the cloud -> median time of an observation after a key frame of an expert [ms]."""
    from lerobot_env_adamanip.simulator import make_task

    found = {}
    for source in CLOUD_SOURCES:
        task = make_task(category, objects=object_id(category, 0), cloud_source=source)
        try:
            found[source] = {"total": _observation_ms(task, repeats)}
        finally:
            task.close()
    return found


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
            workspace_cloud(task.observe(image=False).points_in_base, Workspace(), DEFAULT_NUM_POINTS)
            times.append(1e3 * (time.perf_counter() - begin))
            goal = next_goal(expert, felt)
    return round(statistics.median(times[1:]), 3)


class Policies:
    """Policies of the presets `BEFORE` and `NOW` on a dataset.

    Args:
        root: folder of the dataset; read when something is measured.
        batch_size: of a training step.
        device: of the policies.
    """

    def __init__(self, root: Path, batch_size: int, device: str) -> None:
        self.root, self.batch_size, self.device = root, batch_size, device

    def training(self, repeats: int) -> Numbers:
        """Returns preset -> time of a training step [ms], and of the preset `NOW` one read row by row (plain)."""
        steps = {name: self._step(name) for name in (BEFORE, NOW)}
        times = compare_ms({**steps, "plain": partial(steps[NOW], row_by_row=True)}, repeats)
        presets: Numbers = {name: {"ms": {"total": times[name]}} for name in (BEFORE, NOW)}
        return {**presets, "plain_ms": times["plain"], "speedup": round(times["plain"] / times[NOW], 2)}

    def action(self, repeats: int) -> Numbers:
        """Returns preset -> time to an action [ms] in one environment and in ten, and `NOW`'s speed-up."""
        actors = {name: self._actor(name) for name in (BEFORE, NOW)}
        found: Numbers = {name: {} for name in (BEFORE, NOW, "speedup")}
        for size in (1, 10):
            times = compare_ms({name: partial(actor, size) for name, actor in actors.items()}, repeats)
            for name, value in {**times, "speedup": round(times[BEFORE] / times[NOW], 2)}.items():
                found[name][f"batch_{size}"] = value
        return found

    def _policy(self, preset: str) -> tuple[Any, Any, Any, Any]:
        """Returns policy, preprocessor, postprocessor and dataset, as lerobot-train makes them."""
        from lerobot_policy_adamanip import DP3AdaptiveConfig
        from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy
        from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import make_dp3_adaptive_pre_post_processors

        meta = LeRobotDatasetMetadata(f"local/{self.root.name}", root=self.root)
        features = dataset_to_policy_features(meta.features)
        outputs = {key: value for key, value in features.items() if value.type is FeatureType.ACTION}
        config = DP3AdaptiveConfig(preset=preset, device=self.device, output_features=outputs)
        inputs = {key: value for key, value in features.items() if key not in outputs}
        points = max(config.num_points or 0, inputs[POINT_CLOUD].shape[0] // 3)
        config.input_features = {**inputs, POINT_CLOUD: PolicyFeature(FeatureType.STATE, (points, 3))}
        dataset = open_dataset(self.root, delta_timestamps=resolve_delta_timestamps(config, meta))
        policy = DP3AdaptivePolicy(config, dataset_stats=meta.stats, dataset_meta=dataset.meta).to(self.device)
        return policy, *make_dp3_adaptive_pre_post_processors(config, meta.stats), dataset

    def _step(self, preset: str) -> Callable[..., None]:
        policy, before, _, dataset = self._policy(preset)
        policy.train()
        settings = policy.config.get_optimizer_preset()
        optimizer, rng = settings.build(policy.get_optim_params()), np.random.default_rng(0)

        def step(*, row_by_row: bool = False) -> None:
            rows = rng.integers(len(dataset), size=self.batch_size).tolist()
            items = [dataset[row] for row in rows] if row_by_row else _items(dataset, rows)
            batch = torch.utils.data.default_collate(items)
            batch[POINT_CLOUD] = _enough_points(batch[POINT_CLOUD], policy.config.num_points)
            policy.forward(before(batch))[0].backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), settings.grad_clip_norm)
            optimizer.step()
            optimizer.zero_grad()
            policy.update()
            self._synchronise()

        return step

    def _actor(self, preset: str) -> Callable[[int], None]:
        policy, before, after, dataset = self._policy(preset)
        policy.eval()
        item = dataset[0]

        def act(size: int) -> None:
            latest = {
                key: item[key][-1] if f"{key}_is_pad" in item else item[key] for key in policy.config.input_features
            }
            seen = {key: value.unsqueeze(0).repeat(size, *(1,) * value.dim()) for key, value in latest.items()}
            seen[POINT_CLOUD] = _enough_points(seen[POINT_CLOUD], policy.config.num_points)
            policy.reset()
            with torch.inference_mode():
                after(policy.select_action(before(seen)))
            self._synchronise()

        return act

    def _synchronise(self) -> None:
        if self.device == "cuda":
            torch.cuda.synchronize()


def _items(dataset: Any, rows: list[int]) -> list[Any]:
    """Returns rows as torch's DataLoader asks for them: at once, if the dataset can."""
    at_once = getattr(dataset, "__getitems__", None)
    return [dataset[row] for row in rows] if at_once is None else list(at_once(rows))


def _enough_points(cloud: torch.Tensor, num_points: int) -> torch.Tensor:
    """Returns clouds (..., N, 3) of at least ``num_points``, by repetition: time does not depend on where they are."""
    cloud = as_points(cloud)
    times = -(-num_points // cloud.shape[-2])
    return torch.cat([cloud] * times, dim=-2) if times > 1 else cloud
