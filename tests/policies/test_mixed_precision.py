"""Mixed precision, as `--policy.use_amp=true` runs it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs.types import FeatureType, PolicyFeature

from lerobot_adamanip.contract import schema
from lerobot_policy_adamanip import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.training_windows import Window


def make_policy(**options: Any) -> Any:
    from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy

    sizes: dict[str, Any] = {"num_points": 16, "encoder_dims": (8,), "encoder_out_dim": 8, "down_dims": (16, 32)}
    config = DP3AdaptiveConfig(device="cpu", push_to_hub=False, **sizes, **options)
    shapes = {schema.POINT_CLOUD: (32, 3), schema.STATE: (schema.STATE_DIM,)}
    config.input_features = {key: PolicyFeature(FeatureType.STATE, shape) for key, shape in shapes.items()}
    config.output_features = {schema.ACTION: PolicyFeature(FeatureType.ACTION, (schema.ACTION_DIM,))}
    policy = DP3AdaptivePolicy(config)
    if config.head == "anchors":
        policy.fit_anchors(np.random.default_rng(0).normal(size=(40, 7)).astype(np.float32))
    return policy


@pytest.mark.skipif(not torch.ops.mkldnn._is_mkldnn_bf16_supported(), reason="this CPU does not run bfloat16")
@pytest.mark.parametrize("preset", ["fast", "diffusion"])
def test_a_policy_trains_and_acts_in_half_precision(preset: str) -> None:
    policy = make_policy(preset=preset, use_amp=True)
    config, past = policy.config, policy.config.n_action_history_steps
    states = torch.rand(2, config.observed_steps, schema.STATE_DIM)
    observations = {schema.POINT_CLOUD: torch.rand(2, 1, 32, 3), schema.STATE: states}
    window = Window(observations, torch.rand(2, past, schema.ACTION_DIM), torch.ones(2, past, dtype=torch.bool))
    labels = torch.rand(2, config.horizon, schema.ACTION_DIM)
    policy.training_window = lambda _: (window, labels, torch.ones(labels.shape[:2], dtype=torch.bool))
    with torch.autocast("cpu", torch.bfloat16):
        loss, _ = policy.forward({})
        loss.backward()
        assert all(weight.grad is not None for weight in policy.get_optim_params())
        action = policy.eval().select_action({key: values[:, -1] for key, values in observations.items()})
    assert torch.isfinite(loss)
    assert action.dtype == torch.float32
    assert torch.isfinite(action).all()
