"""What a checkpoint says, when it is loaded, that it was trained on."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest
from doc_data import collect_fake_demos

from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.contract import LoadsStrictly
from lerobot_policy_adamanip.common.trained_on import log_training_objects


def logged(checkpoint: Path, caplog: pytest.LogCaptureFixture) -> list[str]:
    caplog.clear()
    with caplog.at_level(logging.INFO, "lerobot_policy_adamanip"):
        log_training_objects(checkpoint)
    return [each.message for each in caplog.records]


def checkpoint_of(folder: Path, content: str) -> Path:
    (folder / "train_config.json").write_text(content, encoding="utf-8")
    return folder


def test_a_policy_tells_its_objects(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    root = tmp_path / "outputs" / "demos"
    collect_fake_demos(root)
    checkpoint_of(tmp_path, json.dumps({"dataset": {"root": str(root), "repo_id": "local/x"}}))
    said = "The policy was trained on 2 objects: safe_000, safe_001."
    assert logged(tmp_path, caplog) == [said]

    class Stub:
        @classmethod
        def _load_as_safetensor(cls, *_: object) -> None:
            raise RuntimeError("no weights")

    class Policy(LoadsStrictly, Stub):
        pass

    caplog.clear()
    with caplog.at_level(logging.INFO), pytest.raises(ConfigurationError):
        Policy._load_as_safetensor(None, str(tmp_path / "model.safetensors"), "cpu", False)
    assert said in caplog.text


@pytest.mark.parametrize(
    "content", ["", "[]", "{", '{"dataset": 3}', '{"dataset": {"root": 3}}', '{"dataset": {"root": "gone"}}']
)
def test_what_a_checkpoint_does_not_tell_harms_nothing(
    content: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert logged(checkpoint_of(tmp_path, content), caplog) == []
    assert logged(tmp_path / "none", caplog) == []
