"""`adamanip push` as typed: to HF_ENDPOINT, with what it prints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from loopback_hub import LoopbackHub

from lerobot_adamanip.cli.main import main
from lerobot_adamanip.contract.categories import CATEGORIES

COMMAND = ("-m", "lerobot_adamanip.cli.main", "push")


def test_the_environments_go_to_hf_endpoint(run: Any, hub: LoopbackHub) -> None:
    options = (*COMMAND, "environment", "--repo-id", "someone/env", "--release", "release-1", "--json")
    told = json.loads(run(*options).stdout)
    remote = hub.files("models", "someone/env")
    assert {f"envs/{name}.py" for name in CATEGORIES} | {"env.py", "README.md", "requirements.txt"} == set(remote)
    assert told["commit"] == hub.repositories["models", "someone/env"].tags["release-1"]
    assert told["bytes"] == sum(map(len, remote.values()))
    assert f"was there already: {len(CATEGORIES) + 3} files" in run(*options[:-1]).stdout


def test_a_dry_run_lists_and_sends_nothing(published: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["push", "dataset", str(published), "--repo-id", "someone/safes", "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["files"].keys() == {str(p.relative_to(published)) for p in published.rglob("*") if p.is_file()}
    assert "repo_id=someone/safes" in told["card"]
    assert main(["push", "dataset", str(published), "--repo-id", "someone/safes", "--dry-run"]) == 0
    assert told["card"] in capsys.readouterr().out
