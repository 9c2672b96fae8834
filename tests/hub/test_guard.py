"""The guard sees what it is there for: addresses written into a library, in this process and in its children."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from huggingface_hub import ModelCard
from loopback_hub import LoopbackHub

CARD = "---\nlicense: apache-2.0\n---\n"
VALIDATE = f"from huggingface_hub import ModelCard; ModelCard({CARD!r}).validate()"
GRANDCHILD = f"import subprocess, sys; sys.exit(subprocess.run([sys.executable, '-c', {VALIDATE!r}]).returncode)"


def test_an_address_of_the_librarys_own_is_refused_and_noted(online: None, refused: Path) -> None:
    with pytest.raises(Exception, match="not loopback"):
        ModelCard(CARD).validate()
    assert "huggingface.co" in refused.read_text()
    refused.unlink()  # else this test would fail, as it should


@pytest.mark.parametrize("code", [VALIDATE, GRANDCHILD], ids=["child", "grandchild"])
def test_of_children_too_whatever_hf_endpoint_says(run: Any, hub: LoopbackHub, refused: Path, code: str) -> None:
    assert run("-c", code, check=False).returncode != 0
    assert "huggingface.co" in refused.read_text()
    assert hub.requests == []
    refused.unlink()
