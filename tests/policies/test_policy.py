"""The policies' base: no local path is published, and a checkpoint says what it was trained on."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from doc_data import collect_fake_demos
from lerobot.policies.pretrained import PreTrainedPolicy

from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.policy import log_training_objects

HOOK = "generate_model_card"


def test_a_push_without_lerobots_hook_is_refused_before_the_training(
    make_toy_policy: Callable[..., tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = make_toy_policy("sampling", push_to_hub=True, repo_id="someone/policy")[0]
    monkeypatch.setattr(PreTrainedPolicy, HOOK, None, raising=False)
    assert len(list(policy.get_optim_params())) > 0
    monkeypatch.delattr(PreTrainedPolicy, HOOK)
    for publish in (policy.get_optim_params, lambda: policy.push_to_hub("someone/policy")):
        with pytest.raises(ConfigurationError, match="adamanip push model"):
            publish()
    policy.config.push_to_hub = False
    assert len(list(policy.get_optim_params())) > 0


def test_a_checkpoint_names_its_objects(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = tmp_path / "outputs" / "demos"
    collect_fake_demos(root)
    described = tmp_path / "train_config.json"
    with caplog.at_level(logging.INFO, "lerobot_policy_adamanip"):
        for content in ("", "[]", "{", '{"dataset": 3}', '{"dataset": {"root": 3}}', '{"dataset": {"root": "gone"}}'):
            described.write_text(content, encoding="utf-8")
            log_training_objects(tmp_path)
            log_training_objects(tmp_path / "none")
        assert caplog.messages == []
        described.write_text(json.dumps({"dataset": {"root": str(root), "repo_id": "local/x"}}))
        log_training_objects(tmp_path)
    assert caplog.messages == ["The policy was trained on 2 objects: safe_000, safe_001."]
