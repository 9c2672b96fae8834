"""A small benchmark whose commands are stood in for by `fake_command`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from records import record

from lerobot_adamanip.benchmark.declaration import Declaration, parse_declaration
from lerobot_adamanip.benchmark.folder import BenchmarkFolder
from lerobot_adamanip.benchmark.plan import Cell, KeyVersions, all_cells
from lerobot_adamanip.benchmark.run import BenchmarkRun, CellState
from lerobot_adamanip.evaluation.provenance import Origin

FAKE = Path(__file__).with_name("fake_command.py")
SCALE = "tiny"
FAILED = 7
VERSIONS = KeyVersions(policies={"untrained": "their-lab 1.0"})
ORIGIN = Origin("c" * 40, False, "0.3.0", {"python": "3.12.0", "torch": "2.11.0"})


def content() -> dict[str, Any]:
    """A declaration, as TOML would be decoded."""
    return {
        "reference": "ours",
        "scales": {
            SCALE: {
                "categories": ["safe"], "splits": ["seen", "unseen"], "objects": "0:2", "demonstrations": 6,
                "steps": 8, "batch_size": 2, "save_every": 3, "episodes": 5, "environments": 2, "device": "cpu",
            },
        },
        "demonstrations": {"adaptive": {}, "static": {"expert": "static"}},
        "methods": {
            "untrained": {"title": "Untrained", "policy": "luck", "paper": "Sampling"},
            "ours_on_static": {"title": "Ours on static", "policy": "dp3_adaptive", "demonstrations": "static"},
            "ours": {"title": "Ours", "policy": "dp3_adaptive", "demonstrations": "adaptive", "paper": "Ours"},
        },
    }  # fmt: skip


def declared(**changes: Any) -> Declaration:
    """The declaration, with other values of its tables."""
    return parse_declaration({**content(), **changes})


def with_scale(**changes: Any) -> Declaration:
    """The declaration, with other values of its scale."""
    scale = content()["scales"][SCALE]
    return declared(scales={SCALE: {**scale, **changes}})


class FakeRunner:
    """Runs `fake_command` instead of programs.

    Attributes:
        called: command lines, as given.
        failing: program that does nothing and ends with ``status``.
        threads: that each was given.
        processes: that were begun.
        most_at_once: of them.
    """

    def __init__(self, folder: Path, *, pause: float = 0.0, die: str = "") -> None:
        self.called: list[list[str]] = []
        self.failing, self.status = "", FAILED
        self.threads: list[int] = []
        self.processes: list[subprocess.Popen[bytes]] = []
        self.most_at_once = 0
        self._templates = folder / "templates.json"
        self._environment = {**os.environ, "FAKE_PAUSE": str(pause), "FAKE_DIE": die}
        folder.mkdir(parents=True, exist_ok=True)
        self._templates.write_text(json.dumps(templates()))

    def __call__(
        self, command: Sequence[str], *, folder: Path, log: Path, lock: int, threads: int
    ) -> subprocess.Popen[bytes]:
        self.called.append(list(command))
        self.threads.append(threads)
        line = [sys.executable, "-I", "-S", str(FAKE), str(self._templates), *command]
        if command[0] == self.failing:
            line = ["sh", "-c", f"exit {self.status}"]
        with log.open("ab") as said:
            process = subprocess.Popen(
                line, cwd=folder, env=self._environment, stdout=said, stderr=said, pass_fds=(lock,)
            )
        self.processes.append(process)
        self.most_at_once = max(self.most_at_once, sum(each.poll() is None for each in self.processes))
        return process

    @property
    def programs(self) -> list[str]:
        return [command[0] for command in self.called]


def templates() -> dict[str, list[dict[str, Any]]]:
    """Category -> records that the stand-in of `lerobot-eval` chooses from."""
    safe = [
        record(object_id="safe_000", locked=locked, success=success, blocked_pulls=int(locked), key_moved=locked)
        for locked in (False, True)
        for success in (False, True, True)
    ]
    bottle = [
        record(object_id="bottle_000", success=success, direction=direction, wrong_turns=int(direction < 0))
        for direction in (1, -1)
        for success in (False, True)
    ]
    return {"safe": [each.to_json() for each in safe], "bottle": [each.to_json() for each in bottle]}


def benchmark(root: Path, runner: FakeRunner, declaration: Declaration | None = None, **changes: Any) -> BenchmarkRun:
    """The benchmark in the folder ``root``."""
    values: dict[str, Any] = {
        "declaration": declaration or declared(), "scale": SCALE, "folder": BenchmarkFolder(root), "versions": VERSIONS,
        "origin": ORIGIN, "machine": {"cores": 2, "gpu": False}, "runner": runner, **changes,
    }  # fmt: skip
    return BenchmarkRun(**{"origin_now": lambda: values["origin"], **values})


def run_all(made: BenchmarkRun) -> list[CellState]:
    return list(made.run(cells_of(made)))


def cells_of(made: BenchmarkRun) -> list[Cell]:
    return all_cells(made.declaration, made.scale)


def results(root: Path) -> dict[str, Any]:
    """File name -> content of the results in a benchmark's folder, less what is not the same every time."""
    contents = {path.name: json.loads(path.read_text()) for path in sorted((root / "cells").iterdir())}
    for content in contents.values():
        del content["seconds"], content["machine"], content["run"]["costs"]
    return contents
