"""Real-time chunking and the asynchronous policy server: policies with a history refuse them with a reason."""

from __future__ import annotations

import runpy
from collections.abc import Callable
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import lerobot
import numpy as np
import pytest
import torch
from toy_demos import observed, toy_world

from lerobot_adamanip.util.errors import ConfigurationError

HISTORIES = ("dp3_adaptive", "adaafford")


@pytest.fixture
def make(make_toy_policy: Callable[..., tuple[Any, ...]], adaptive_toy_root: Path) -> Callable[..., tuple[Any, Any]]:
    """Builds an untrained policy and its preprocessor; what is given wins."""

    def build(policy_type: str, **changes: Any) -> tuple[Any, Any]:
        policy, before, *_ = make_toy_policy(policy_type, adaptive_toy_root, **changes)
        return policy.eval(), before

    return build


@pytest.fixture
def observations() -> list[dict[str, torch.Tensor]]:
    """Three that differ."""
    return [observed(toy_world("bottle_000", seed), np.random.default_rng(seed)) for seed in range(3)]


def test_lerobots_rollout_and_policy_server_refuse_the_type(make: Any, tmp_path: Path) -> None:
    from lerobot.rollout.context import build_rollout_context
    from lerobot.rollout.inference import RTCInferenceConfig

    server = runpy.run_path(str(Path(lerobot.__file__).parent / "async_inference" / "constants.py"))
    for policy_type in (*HISTORIES, "sampling", "vat_mart"):
        assert policy_type not in server["SUPPORTED_POLICIES"]
        policy, _ = make(policy_type)
        policy.save_pretrained(tmp_path)
        policy.config.pretrained_path = tmp_path
        wanted = SimpleNamespace(
            inference=RTCInferenceConfig(), policy=policy.config, use_torch_compile=False, device="cpu", robot=None
        )
        with pytest.raises(ValueError, match=r"RTC inference is not supported .*--inference.type=sync"):
            build_rollout_context(wanted, Event())


@pytest.mark.parametrize("options", [{"preset": "dp3", "n_obs_steps": 2}, {"preset": "keyframe"}], ids=str)
def test_without_a_history_of_actions_chunks_of_any_observations_are_given(
    make: Any, observations: Any, options: dict[str, Any]
) -> None:
    policy, before = make("dp3_adaptive", n_action_history_steps=0, **options)
    for observation in observations:
        chunk = policy.predict_action_chunk(before(observation))
        assert chunk.shape == (1, policy.config.horizon, 10)


@pytest.mark.parametrize("policy_type", HISTORIES)
def test_chunks_are_given_between_selected_actions_and_refused_without(
    make: Any, observations: Any, policy_type: str
) -> None:
    """As a policy server asks: the first chunk is right, for nothing was executed before it."""
    policy, before = make(policy_type)
    first, *later = (before(dict(each)) for each in observations)
    for observation in (first, *later):
        policy.predict_action_chunk(observation)
        policy.predict_action_chunk(observation)
        policy.select_action(observation)
    policy.reset()
    policy.predict_action_chunk(first)
    for observation in later:  # again and again: a server logs the error and asks once more
        with pytest.raises(ConfigurationError, match=r"history(.|\n)*try: +lerobot-rollout --inference.type=sync"):
            policy.predict_action_chunk(observation)
