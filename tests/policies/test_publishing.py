"""`--policy.push_to_hub=true` publishes no local path: refused where LeRobot offers no hook for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from lerobot.policies.pretrained import PreTrainedPolicy

from lerobot_adamanip.util.errors import ConfigurationError

HOOK = "generate_model_card"


def test_a_push_without_the_hook_is_refused_before_the_training(
    make_toy_policy: Callable[..., tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(PreTrainedPolicy, HOOK, raising=False)
    policy = make_toy_policy("sampling", push_to_hub=True, repo_id="someone/policy")[0]
    for publish in (policy.get_optim_params, lambda: policy.push_to_hub("someone/policy")):
        with pytest.raises(ConfigurationError, match="adamanip push model"):
            publish()
    policy.config.push_to_hub = False
    assert len(list(policy.get_optim_params())) > 0


def test_a_push_with_the_hook_is_accepted(
    make_toy_policy: Callable[..., tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PreTrainedPolicy, HOOK, None, raising=False)
    policy = make_toy_policy("sampling", push_to_hub=True, repo_id="someone/policy")[0]
    assert len(list(policy.get_optim_params())) > 0
