"""Real-time chunking and the asynchronous policy server: policies with a history refuse them with a reason."""

from __future__ import annotations

import importlib
import pickle
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from toy_demos import REPO_ID, TINY, observed, toy_world

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError

DP3_ADAPTIVE: dict[str, Any] = {
    "preset": "fast", "num_anchors": 6, "num_points": 48, "training_points": 24, "coarse_points": 32,
    "encoder_dims": (16, 24), "encoder_out_dim": 16, "device": "cpu", "push_to_hub": False,
}  # fmt: skip
HISTORIES = ("dp3_adaptive", "adaafford")
every_policy = pytest.mark.parametrize("policy_type", [*HISTORIES, "sampling", "vat_mart"])
with_history = pytest.mark.parametrize("policy_type", HISTORIES)


@pytest.fixture
def make(adaptive_toy_root: Path) -> Callable[..., tuple[Any, Any, Any]]:
    """Builds an untrained (policy, preprocessor, postprocessor); what is given wins."""

    def build(policy_type: str, **changes: Any) -> tuple[Any, Any, Any]:
        from lerobot.datasets.lerobot_dataset import LeRobotDatasetMetadata
        from lerobot.policies.factory import make_policy, make_policy_config, make_pre_post_processors

        import lerobot_policy_adamanip  # noqa: F401  (registers them)

        meta = LeRobotDatasetMetadata(REPO_ID, root=adaptive_toy_root)
        options = DP3_ADAPTIVE if policy_type == "dp3_adaptive" else TINY
        config = make_policy_config(policy_type, **{**options, **changes})
        policy = make_policy(config, ds_meta=meta).eval()
        return policy, *make_pre_post_processors(config, dataset_stats=meta.stats)

    return build


@pytest.fixture
def observations() -> list[dict[str, torch.Tensor]]:
    """Three that differ."""
    return [observed(toy_world("bottle_000", seed), np.random.default_rng(seed)) for seed in range(3)]


@pytest.fixture
def policy_server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Any]:
    """LeRobot's module of that name, with a gRPC that carries nothing."""
    monkeypatch.chdir(tmp_path)  # it writes logs where it is
    held: dict[str, dict[str, Any]] = {
        "grpc": {},
        "lerobot.transport": {
            "services_pb2": SimpleNamespace(Empty=SimpleNamespace),
            "services_pb2_grpc": SimpleNamespace(AsyncInferenceServicer=object),
        },
        "lerobot.transport.utils": {"receive_bytes_in_chunks": None},
    }
    for name, attributes in held.items():
        module = ModuleType(name)
        vars(module).update(attributes)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr("lerobot.utils.import_utils.require_package", lambda *_, **__: None)
    _forget_server()
    yield importlib.import_module("lerobot.async_inference.policy_server")
    _forget_server()


def _forget_server() -> None:
    for name in [name for name in sys.modules if name.startswith("lerobot.async_inference")]:
        del sys.modules[name]


def serve(module: Any, checkpoint: Path, policy_type: str) -> Any:
    """Returns a server that has been told which policy to load."""
    server = module.PolicyServer(SimpleNamespace(fps=30))
    wanted = module.RemotePolicyConfig(policy_type, str(checkpoint), {}, actions_per_chunk=4)
    server.SendPolicyInstructions(SimpleNamespace(data=pickle.dumps(wanted)), SimpleNamespace(peer=lambda: "client"))
    return server


@every_policy
def test_lerobots_rollout_refuses_real_time_chunking(make: Any, policy_type: str, tmp_path: Path) -> None:
    from lerobot.rollout.context import build_rollout_context
    from lerobot.rollout.inference import RTCInferenceConfig

    policy, *_ = make(policy_type)
    policy.save_pretrained(tmp_path)
    policy.config.pretrained_path = tmp_path
    wanted = SimpleNamespace(
        inference=RTCInferenceConfig(), policy=policy.config, use_torch_compile=False, device="cpu", robot=None
    )
    with pytest.raises(ValueError, match=r"RTC inference is not supported .*--inference.type=sync"):
        build_rollout_context(wanted, Event())


@every_policy
def test_lerobots_policy_server_refuses_the_type(policy_server: Any, policy_type: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"Policy type {policy_type} not supported"):
        serve(policy_server, tmp_path, policy_type)


@with_history
def test_a_policy_server_that_loads_it_is_refused_at_the_second_observation(
    make: Any, observations: Any, policy_server: Any, policy_type: str, tmp_path: Path
) -> None:
    """Forks of the server load every type; the first chunk is right, for nothing was executed before it."""
    policy, before, after = make(policy_type)
    policy.save_pretrained(tmp_path)
    before.save_pretrained(tmp_path)
    after.save_pretrained(tmp_path)
    policy_server.SUPPORTED_POLICIES.append(policy_type)
    server = serve(policy_server, tmp_path, policy_type)
    first, *later = (server.preprocessor(dict(each)) for each in observations)
    assert server._get_action_chunk(first).shape[-1] == schema.ACTION_DIM
    for observation in later:  # again and again: a server logs the error and asks once more
        with pytest.raises(ConfigurationError, match=r"history(.|\n)*try: +lerobot-rollout --inference.type=sync"):
            server._get_action_chunk(observation)


@with_history
def test_chunks_between_selected_actions_and_of_new_episodes_are_given(
    make: Any, observations: Any, policy_type: str
) -> None:
    policy, before, _ = make(policy_type)
    seen = [before(dict(each)) for each in observations]
    for observation in seen:
        policy.predict_action_chunk(observation)
        policy.predict_action_chunk(observation)
        policy.select_action(observation)
    for observation in seen:
        policy.reset()
        policy.predict_action_chunk(observation)


def test_a_policy_without_history_gives_chunks_of_any_observation(make: Any, observations: Any) -> None:
    policy, before, _ = make("dp3_adaptive", preset="fast", n_action_history_steps=0, n_obs_steps=1)
    for observation in observations:
        policy.predict_action_chunk(before(dict(observation)))
