"""AdamW in one kernel: the numbers of LeRobot's, saved and resumed as LeRobot's is."""

from __future__ import annotations

import copy
from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from lerobot.optim.optimizers import AdamWConfig, OptimizerConfig, load_optimizer_state, save_optimizer_state

from lerobot_policy_adamanip import DP3AdaptiveConfig
from lerobot_policy_adamanip.common.config import FusedAdamWConfig

VALUES = {"lr": 1e-2, "betas": (0.95, 0.999), "weight_decay": 1e-2}


def trained(model: torch.nn.Module, optimizer: torch.optim.Optimizer, steps: int, seed: int = 0) -> list[torch.Tensor]:
    """The weights after some steps on data of a seed."""
    draw = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        optimizer.zero_grad()
        model(torch.randn(16, 5, generator=draw)).square().mean().backward()
        optimizer.step()
    return [weight.detach().clone() for weight in model.parameters()]


def small_model() -> torch.nn.Module:
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(5, 33), torch.nn.Tanh(), torch.nn.Linear(33, 3))


def test_it_is_adamw_up_to_rounding() -> None:
    one = small_model()
    other = copy.deepcopy(one)
    fused, plain = FusedAdamWConfig(**VALUES).build(one.parameters()), AdamWConfig(**VALUES).build(other.parameters())
    assert fused.defaults["fused"]
    torch.testing.assert_close(trained(one, fused, 50), trained(other, plain, 50), rtol=1e-4, atol=1e-6)


def test_groups_and_devices_without_the_kernel_are_served() -> None:
    model = small_model()
    groups = [{"params": [weight], "lr": 0.1 * place} for place, weight in enumerate(model.parameters(), 1)]
    assert [group["lr"] for group in FusedAdamWConfig().build(groups).param_groups] == pytest.approx(
        [0.1, 0.2, 0.3, 0.4]
    )
    elsewhere = small_model().to("meta")
    assert not FusedAdamWConfig().build(elsewhere.parameters()).defaults["fused"]


def test_a_saved_state_goes_on_as_if_never_saved(tmp_path: Path) -> None:
    model = small_model()
    optimizer = FusedAdamWConfig(**VALUES).build(model.parameters())
    trained(model, optimizer, 10)
    save_optimizer_state(optimizer, tmp_path)
    resumed = copy.deepcopy(model)
    again = load_optimizer_state(FusedAdamWConfig(**VALUES).build(resumed.parameters()), tmp_path)
    torch.testing.assert_close(trained(resumed, again, 10, 1), trained(model, optimizer, 10, 1), rtol=1e-5, atol=1e-7)


def test_lerobot_knows_it_by_name_and_the_policy_asks_for_it() -> None:
    preset = DP3AdaptiveConfig(device="cpu", optimizer_lr=3e-4).get_optimizer_preset()
    assert OptimizerConfig.get_choice_class(preset.type) is FusedAdamWConfig
    assert preset.lr == 3e-4
    assert asdict(preset).keys() == asdict(AdamWConfig()).keys()
