"""PEFT: a policy whose averaged weights act refuses it through LeRobot's own hooks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from lerobot_adamanip.util.errors import ConfigurationError


@pytest.mark.parametrize("preset", ["fast", "dp3"])
def test_a_policy_with_an_average_refuses_adapters(make_tiny: Callable[..., Any], preset: str) -> None:
    policy, *_ = make_tiny(preset=preset)
    policy.config.pretrained_path = "checkpoint"
    for hook in (policy._get_default_peft_targets, lambda: policy._validate_peft_config(object())):
        with pytest.raises(ConfigurationError, match=r"(?s)cannot be trained with PEFT.*without --peft"):
            hook()
