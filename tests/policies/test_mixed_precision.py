"""Mixed precision, as `--policy.use_amp=true` runs it, if a machine can; one clear error if it cannot."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs.types import FeatureType, PolicyFeature

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util import mixed_precision
from lerobot_adamanip.util.errors import ConfigurationError
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


@pytest.fixture
def _nothing_known() -> Iterator[None]:
    mixed_precision.mixed_precision_problem.cache_clear()
    yield
    mixed_precision.mixed_precision_problem.cache_clear()


@pytest.mark.parametrize("preset", ["fast", "diffusion"])
def test_a_policy_trains_and_acts_in_half_precision_exactly_where_the_probe_says_so(preset: str) -> None:
    if mixed_precision.mixed_precision_problem("cpu") is not None:
        with pytest.raises(ConfigurationError, match=r"--policy.use_amp=false"):
            make_policy(preset=preset, use_amp=True)
        return
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


@pytest.mark.usefixtures("_nothing_known")
@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("raise RuntimeError('could not create a primitive')", "could not create a primitive"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGILL)", "signal 4"),
        ("import time; time.sleep(30)", "no answer"),
    ],
)
def test_a_machine_that_cannot_is_one_clear_error(monkeypatch: pytest.MonkeyPatch, code: str, said: str) -> None:
    real = subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda _command, **kw: real([sys.executable, "-c", code], **kw))
    monkeypatch.setattr(mixed_precision, "PROBE_TIMEOUT_S", 2.0)
    wanted = r"(?s)mixed precision.*use_amp=true on cpu.*--policy.use_amp=false"
    with pytest.raises(ConfigurationError, match=wanted) as caught:
        make_policy(use_amp=True)
    assert said in str(caught.value)
    make_policy(use_amp=False)  # and without, nothing is asked
