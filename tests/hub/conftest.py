"""A finished dataset of the fake environment, a Hub on loopback, and processes that reach nothing else."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import loopback_guard
import pytest
from loopback_hub import TOKEN, LoopbackHub
from tiny_training import TINY

from lerobot_adamanip.hub.staging import Staged, stage_dataset

ROOT = Path(__file__).resolve().parents[2]
GUARD = Path(__file__).with_name("guard")
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(autouse=True)
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Fails a test of which anything, children included, tried to leave loopback. Gives the list of such attempts."""
    log = tmp_path / "left-loopback.log"
    monkeypatch.setenv(loopback_guard.LOG, str(log))
    loopback_guard.install()
    yield log
    assert not log.exists(), log.read_text()


@pytest.fixture
def hub() -> Iterator[LoopbackHub]:
    with LoopbackHub() as running:
        yield running


@pytest.fixture
def online(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets the Hub's client use the network in this process: its switches were read when it was imported."""
    from huggingface_hub import close_session, constants

    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    close_session()


@pytest.fixture
def api(hub: LoopbackHub, online: None, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A client of the Hub on loopback, which does not wait before it tries again."""
    from huggingface_hub import HfApi
    from huggingface_hub.utils import _http

    monkeypatch.setattr(_http.time, "sleep", lambda _: None)
    return HfApi(endpoint=hub.url, token=TOKEN)


@pytest.fixture
def staged(published: Path, tmp_path: Path) -> Staged:
    """The dataset, ready to be published."""
    into = tmp_path / "staged"
    into.mkdir()
    return stage_dataset(published, "someone/safes", into)


@pytest.fixture
def run(hub: LoopbackHub, tmp_path: Path, refused: Path) -> Run:
    """Runs a Python program in a process that knows the Hub on loopback alone, with caches of its own."""

    def call(*words: str, offline: bool = False, check: bool = True, **more: str) -> subprocess.CompletedProcess[str]:
        cache = tmp_path / "cache"
        folders = [GUARD, ROOT, ROOT / "envs", ROOT / "policies"]
        environment = {
            **os.environ, **hub.environment(), "HF_HOME": str(cache), "HF_LEROBOT_HOME": str(cache / "lerobot"),
            "HF_DATASETS_CACHE": str(cache / "datasets"), "HF_HUB_OFFLINE": "1" if offline else "0",
            "PYTHONPATH": os.pathsep.join(map(str, folders)), **more,
        }  # fmt: skip
        done = subprocess.run(
            [sys.executable, *words],
            capture_output=True,
            text=True,
            env=environment,
            cwd=tmp_path,
            timeout=600,
            check=False,
        )
        assert not check or done.returncode == 0, done.stdout[-1500:] + done.stderr[-3000:]
        return done

    return call


@pytest.fixture(scope="session")
def trained(published: Path, once: Callable[[str, Callable[[Path], None]], Path]) -> Path:
    """A policy of three steps on the dataset as it lies here: its folder pretrained_model. Not to be written to."""
    options = (*TINY, "--dataset.repo_id=local/safes", f"--dataset.root={published}", "--policy.push_to_hub=false")

    def train(output: Path) -> None:
        command = [sys.executable, "-m", "lerobot.scripts.lerobot_train", *options, f"--output_dir={output}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stderr[-3000:]

    return once("trained", train) / "checkpoints" / "000003" / "pretrained_model"
