"""Mixed precision, as `--policy.use_amp=true` runs it."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from lerobot.configs.types import FeatureType, PolicyFeature

from lerobot_adamanip import schema
from lerobot_policy_adamanip import DP3AdaptiveConfig

SIZES = {"num_points": 16, "encoder_dims": (8,), "encoder_out_dim": 8, "down_dims": (16, 32)}


@pytest.fixture
def policy() -> Any:
    from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy

    config = DP3AdaptiveConfig(device="cpu", push_to_hub=False, **SIZES)
    config.input_features = {
        schema.POINT_CLOUD: PolicyFeature(FeatureType.STATE, (32, 3)),
        schema.STATE: PolicyFeature(FeatureType.STATE, (schema.STATE_DIM,)),
    }
    config.output_features = {schema.ACTION: PolicyFeature(FeatureType.ACTION, (schema.ACTION_DIM,))}
    return DP3AdaptivePolicy(config)


def test_half_precision_trains_and_acts_in_full_precision_actions(policy: Any) -> None:
    batch = {
        schema.POINT_CLOUD: torch.rand(2, 1, 32, 3),
        schema.STATE: torch.rand(2, 1, schema.STATE_DIM),
        schema.ACTION: torch.rand(2, policy.config.n_action_history_steps + policy.config.horizon, schema.ACTION_DIM),
    }
    batch["action_is_pad"] = torch.zeros(batch[schema.ACTION].shape[:2], dtype=torch.bool)
    with torch.autocast("cpu", torch.bfloat16):
        loss, _ = policy.forward(batch)
        loss.backward()
        policy.eval()
        action = policy.select_action({key: batch[key][:, 0] for key in (schema.POINT_CLOUD, schema.STATE)})
    assert torch.isfinite(loss)
    assert action.dtype == torch.float32
    assert torch.isfinite(action).all()
