"""A policy is evaluated on clouds of the box that it was trained on, or not at all."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import lerobot_env_adamanip  # noqa: F401  (registers the policies)
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.config import AdaManipSafeEnvConfig
from lerobot_env_adamanip.policy_check import require_fitting_policy

CHECKPOINT = Path(__file__).parents[1] / "policies" / "demo_checkpoint"
LOWER, UPPER = (0.2, -0.5, -0.05), (0.9, 0.5, 0.6)


def test_a_policy_of_another_workspace_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = json.loads((CHECKPOINT / "config.json").read_text())
    box = {"workspace_lower": list(LOWER), "workspace_upper": list(UPPER)}
    (tmp_path / "config.json").write_text(json.dumps({**settings, **box}))
    default, same = AdaManipSafeEnvConfig(), AdaManipSafeEnvConfig(workspace_lower=LOWER, workspace_upper=UPPER)
    require_fitting_policy(same, ["safe"])  # no policy is given
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", f"--policy.path={tmp_path}"])
    require_fitting_policy(same, ["safe"])
    pattern = (
        r"(?s)another workspace.*allowed: \(0\.2, -0\.5, -0\.05\).*--env\.workspace_lower='\[0\.2, -0\.5, -0\.05\]'"
    )
    with pytest.raises(ConfigurationError, match=pattern):
        default.create_envs(1)
    monkeypatch.setattr(sys, "argv", ["lerobot-eval", f"--policy.path={CHECKPOINT}"])
    require_fitting_policy(default, ["safe"])
