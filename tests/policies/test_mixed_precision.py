"""Mixed precision, as `--policy.use_amp=true` runs it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

MakeTiny = Callable[..., tuple[Any, ...]]


@pytest.mark.skipif(not torch.ops.mkldnn._is_mkldnn_bf16_supported(), reason="this CPU does not run bfloat16")
@pytest.mark.parametrize("preset", ["fast", "diffusion", "dp3"])
def test_a_policy_trains_and_acts_in_half_precision(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, preset: str
) -> None:
    policy, before, _, dataset = make_tiny(preset=preset, use_amp=True)
    with torch.autocast("cpu", torch.bfloat16):
        loss, _ = policy.forward(batch_of(dataset, before))
        loss.backward()
        assert all(weight.grad is not None for weight in policy.get_optim_params())
        action = policy.eval().select_action(observation_of(dataset, before, 0, 5))
    assert torch.isfinite(loss)
    assert action.dtype == torch.float32
    assert torch.isfinite(action).all()
