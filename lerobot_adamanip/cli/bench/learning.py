"""What the benchmark measures with the dataset and the policy: reading, a training step by stage, an action."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from lerobot_adamanip.cli.bench.timing import Stopwatch, compare_ms, repeat_ms
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.contract.schema import POINT_CLOUD
from lerobot_adamanip.datasets.reading import open_dataset
from lerobot_adamanip.lerobot_patches.batched_reading import read_in_batches

Batch = dict[str, Any]


def make_config(preset: str, features: dict[str, Any], *, device: str) -> Any:
    """Returns the configuration of ``dp3_adaptive`` for a dataset's features; its clouds made as large as it needs."""
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.utils.feature_utils import dataset_to_policy_features

    from lerobot_policy_adamanip import DP3AdaptiveConfig

    found = dataset_to_policy_features(features)
    outputs = {key: value for key, value in found.items() if value.type is FeatureType.ACTION}
    inputs = {key: value for key, value in found.items() if key not in outputs}
    config = DP3AdaptiveConfig(preset=preset, device=device, output_features=outputs)
    assert config.num_points is not None
    points = max(config.num_points, inputs[POINT_CLOUD].shape[0] // 3)
    config.input_features = {**inputs, POINT_CLOUD: PolicyFeature(FeatureType.STATE, (points, 3))}
    return config


def open_for(root: Path, config: Any) -> Any:
    """Returns the dataset as lerobot-train opens it for a policy."""
    from lerobot.datasets.factory import resolve_delta_timestamps
    from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata

    meta = LeRobotDatasetMetadata(f"local/{root.name}", root=root)
    return open_dataset(root, delta_timestamps=resolve_delta_timestamps(config, meta))


def reading(root: Path, *, items: int, repeats: int) -> dict[str, Any]:
    """Returns ms per item of LeRobot's reader, row by row and in batches, and the speed-up."""
    dataset = open_dataset(root)
    read_in_batches(dataset.meta)
    rng = np.random.default_rng(0)

    def draw() -> list[int]:
        return list(map(int, rng.integers(len(dataset), size=items)))

    compared = compare_ms(lambda: [dataset[row] for row in draw()], lambda: dataset.__getitems__(draw()), repeats)
    times = {"row_by_row": compared["plain_ms"] / items, "in_batches": compared["ms"] / items}
    return {"ms_per_item": times, "speed_up": compared["speedup"]}


def make_policy(root: Path, preset: str, *, device: str) -> tuple[Any, Any, Any, Any]:
    """Returns policy, preprocessor, postprocessor and dataset of a preset."""
    from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata

    from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy
    from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import make_dp3_adaptive_pre_post_processors

    config = make_config(preset, LeRobotDatasetMetadata(f"local/{root.name}", root=root).features, device=device)
    dataset = open_for(root, config)
    meta = dataset.meta
    policy = DP3AdaptivePolicy(config, dataset_stats=meta.stats, dataset_meta=meta).to(device)
    before, after = make_dp3_adaptive_pre_post_processors(config, meta.stats)
    return policy, before, after, dataset


def training(root: Path, preset: str, *, batch_size: int, repeats: int, device: str) -> dict[str, Any]:
    """Returns a training step's time by stage [ms]; ``encoder`` and ``head`` are forward and backward together."""
    policy, before, _, dataset = make_policy(root, preset, device=device)
    policy.train()
    preset_ = policy.config.get_optimizer_preset()
    optimizer = preset_.build(policy.get_optim_params())
    watch, rng = Stopwatch(), np.random.default_rng(0)
    for _ in range(1 + repeats):
        with watch.stage("total"):
            with watch.stage("loading"):
                items = dataset.__getitems__(rng.integers(len(dataset), size=batch_size).tolist())
                batch = torch.utils.data.default_collate(items)
            batch[POINT_CLOUD] = enough_points(batch[POINT_CLOUD], policy.config.num_points)
            with watch.stage("preprocessing"):
                batch = before(batch)
                synchronise(device)
            _learn(policy, batch, watch, device)
            with watch.stage("optimizer_and_ema"):
                torch.nn.utils.clip_grad_norm_(policy.get_optim_params(), preset_.grad_clip_norm)
                optimizer.step()
                optimizer.zero_grad()
                policy.update()
                synchronise(device)
    times = watch.medians_ms()
    return {"batch_size": batch_size, "ms": times, "loading_share": round(times["loading"] / times["total"], 4)}


def _learn(policy: Any, batch: Batch, watch: Stopwatch, device: str) -> None:
    """Forward and backward, cut behind the cloud's encoder, so that it and the rest can be timed apart."""
    cut: list[tuple[torch.Tensor, torch.Tensor]] = []
    encoder_watch, whole_watch, encoder = Stopwatch(), Stopwatch(), policy.model.encoder

    def encode(*args: Any) -> torch.Tensor:
        with encoder_watch.stage("forward"):
            whole = type(encoder).forward(encoder, *args)
            synchronise(device)
        cut.append((whole, whole.detach().requires_grad_()))
        return cut[0][1]

    encoder.forward = encode
    try:
        with whole_watch.stage("step"):
            loss, _ = policy.forward(batch)
            loss.backward()
            synchronise(device)
    finally:
        del encoder.forward
    encoded, leaf = cut[0]
    with encoder_watch.stage("backward"):
        torch.autograd.backward(encoded, leaf.grad)
        synchronise(device)
    forward, backward = (encoder_watch.laps[name][0] for name in ("forward", "backward"))
    watch.laps.setdefault("encoder", []).append(forward + backward)
    watch.laps.setdefault("head", []).append(whole_watch.laps["step"][0] - forward)


def acting(root: Path, preset: str, *, batch_sizes: tuple[int, ...], repeats: int, device: str) -> dict[str, float]:
    """Returns the time to an action [ms], for each batch size: processing and generating a chunk, none left over."""
    act = actor(root, preset, device=device)
    return {f"batch_{size}": repeat_ms(partial(act, size), repeats) for size in batch_sizes}


def acting_against(
    root: Path, before: str, after: str, *, batch_sizes: tuple[int, ...], repeats: int, device: str
) -> dict[str, dict[str, float]]:
    """Returns plain_ms, ms and speedup of preset ``after`` against ``before``, in turns, for each batch size."""
    plain, fast = (actor(root, preset, device=device) for preset in (before, after))
    return {f"batch_{size}": compare_ms(partial(plain, size), partial(fast, size), repeats) for size in batch_sizes}


def actor(root: Path, preset: str, *, device: str) -> Callable[[int], None]:
    """Returns what acts once, in as many environments as it is told."""
    policy, before, after, dataset = make_policy(root, preset, device=device)
    policy.eval()
    item = dataset[0]

    def act(batch_size: int) -> None:
        observation = {
            key: _repeated(item[key][-1] if f"{key}_is_pad" in item else item[key], batch_size)
            for key in policy.config.input_features
        }
        observation[POINT_CLOUD] = enough_points(observation[POINT_CLOUD], policy.config.num_points)
        # The first action of an episode: nothing is remembered from another number of environments.
        policy.reset()
        with torch.inference_mode():
            after(policy.select_action(before(observation)))
        synchronise(device)

    return act


def _repeated(value: torch.Tensor, batch_size: int) -> torch.Tensor:
    return value.unsqueeze(0).repeat(batch_size, *(1,) * value.dim())


def enough_points(cloud: torch.Tensor, num_points: int) -> torch.Tensor:
    """Returns clouds (..., N, 3) of at least ``num_points``, by repetition: time does not depend on where they are."""
    cloud = as_points(cloud)
    times = -(-num_points // cloud.shape[-2])
    return torch.cat([cloud] * times, dim=-2) if times > 1 else cloud


def synchronise(device: str) -> None:
    """Waits for a GPU."""
    if device == "cuda":
        torch.cuda.synchronize()
