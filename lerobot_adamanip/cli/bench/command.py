"""`adamanip bench`: measure collection, simulation, observation, training and action."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import logging
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lerobot_adamanip.cli.bench.timing import Limit, judge
from lerobot_adamanip.evaluation.provenance import present_origin
from lerobot_adamanip.util.errors import ConfigurationError

LIMITS: dict[str, Limit] = {
    "episodes_per_minute": (8.0, "least"),
    "observation_ms": (15.0, "most"),
    "rendered_by_cast": (7.0, "least"),
    "action_ms": (100.0, "most"),
}
"""What this project promises on two CPU cores without a GPU; the action is the fast preset's, batch 1."""
_PACKAGES = ("lerobot_env_adamanip", "lerobot", "torch", "mani_skill", "sapien")
Results = dict[str, Any]


@dataclass
class Bench:
    """Measures speed on this machine: medians of several repeats after a warm-up. Progress on stderr.

    Ratios are of one run, so they hold on a busy machine too; times and rates are this machine's.
    """

    quick: bool = False
    """Fewer episodes and repeats, and no preset `paper`."""

    paper_training: bool = False
    """Also time training steps of the preset `paper` (minutes without a GPU)."""

    workers: int = 2
    """Processes that collect."""

    batch_size: int = 64
    """Of a training step."""

    device: str = "cpu"
    """Of the policy: cpu or cuda."""

    category: str = "safe"
    """Which kind of object."""

    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> int:
        """Measures everything; 0, whether or not limits are kept."""
        self._check()
        with contextlib.redirect_stdout(sys.stderr), tempfile.TemporaryDirectory(prefix="adamanip-bench-") as folder:
            logging.getLogger().setLevel(logging.ERROR)
            results = self._measure(Path(folder) / "demos")
        report = finish(results)
        if self.json:
            print(json.dumps(report))
        else:
            print_table(report)
        return 0

    def _check(self) -> None:
        import torch

        wrong = self.device not in ("cpu", "cuda") or (self.device == "cuda" and not torch.cuda.is_available())
        if wrong or self.workers < 1 or self.batch_size < 1:
            raise ConfigurationError(
                "Cannot measure that.",
                got=f"--device {self.device} --workers {self.workers} --batch-size {self.batch_size}",
                allowed="cpu, or cuda where there is a GPU; 1 or more",
                hint="adamanip bench --device cpu",
            )

    def _measure(self, root: Path) -> Results:
        from lerobot_adamanip.cli.bench import learning, simulation

        begin = time.monotonic()

        def stage(text: str, measure: Callable[[], Any]) -> Any:
            print(f"[{time.monotonic() - begin:5.0f} s] {text}", file=sys.stderr, flush=True)
            return measure()

        results = self._header()
        repeats, per_object = (3, 1) if self.quick else (7, 2)
        results["collection"] = stage(
            f"collecting {4 * per_object} episodes with {self.workers} workers",
            lambda: simulation.collection(
                root, category=self.category, objects=4, per_object=per_object, workers=self.workers
            ),
        )
        results["simulator"], results["observation_ms"] = stage(
            "simulator and observation", lambda: simulation.simulation(category=self.category, repeats=3 * repeats)
        )
        results["reader"] = stage("dataset reader", lambda: learning.reading(root, items=16, repeats=repeats))
        presets = ("fast", "diffusion", *(("paper",) if self.paper_training else ()))
        results["training"] = {
            name: stage(f"training steps, {name}", partial(self._train, root, name, repeats if name != "paper" else 1))
            for name in presets
        }
        results["levers"] = stage("training, plainly and fast in turns", partial(self._levers, root, repeats))
        results["action_ms"] = {
            name: stage(f"actions, {name}", partial(self._act, root, name, number))
            for name, number in (("fast", 3 * repeats), *((("paper", 1),) if not self.quick else ()))
        }
        results["action_against_diffusion"] = stage(
            "actions, diffusion and fast in turns", partial(self._compare, root)
        )
        results["seconds"] = round(time.monotonic() - begin, 1)
        return results

    def _header(self) -> Results:
        settings = {"quick": self.quick, "device": self.device}
        return {"commit": present_origin().commit, "machine": describe_machine(), "settings": settings}

    def _train(self, root: Path, preset: str, repeats: int) -> Any:
        from lerobot_adamanip.cli.bench import learning

        return learning.training(root, preset, batch_size=self.batch_size, repeats=repeats, device=self.device)

    def _levers(self, root: Path, repeats: int) -> Any:
        from lerobot_adamanip.cli.bench.levers import levers

        return levers(root, "fast", batch_size=self.batch_size, repeats=repeats, device=self.device)

    def _act(self, root: Path, preset: str, repeats: int) -> Any:
        from lerobot_adamanip.cli.bench import learning

        return learning.acting(root, preset, batch_sizes=(1, 10), repeats=repeats, device=self.device)

    def _compare(self, root: Path) -> Any:
        from lerobot_adamanip.cli.bench import learning

        sizes, repeats = (1, 10), 7 if self.quick else 21
        return learning.acting_against(
            root, "diffusion", "fast", batch_sizes=sizes, repeats=repeats, device=self.device
        )


def finish(results: Results) -> Results:
    """Adds the verdicts on the limits, ``limits``: name -> {value, limit, kind, ok}."""
    measured = {
        "episodes_per_minute": results["collection"]["episodes_per_minute"],
        "observation_ms": results["observation_ms"]["raycast"]["total"],
        "rendered_by_cast": results["simulator"]["rendered_by_cast"],
        "action_ms": results["action_ms"]["fast"]["batch_1"],
    }
    return {**results, "limits": judge(measured, LIMITS)}


def describe_machine() -> Results:
    """Returns what times depend on: cores, load, versions."""
    import torch

    versions = {}
    for name in _PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return {
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 2),
        "torch_threads": torch.get_num_threads(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "python": platform.python_version(),
        "platform": platform.machine(),
        "versions": versions,
    }


def flatten(results: Results, prefix: str = "") -> dict[str, Any]:
    """Returns nested results as dotted names."""
    flat: dict[str, Any] = {}
    for name, value in results.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def print_table(report: Results) -> None:
    """The human's version: a line per number, then the limits."""
    from rich.console import Console
    from rich.table import Table

    console = Console(file=sys.stdout)
    table = Table(box=None, pad_edge=False, show_header=False)
    for name, value in flatten({key: value for key, value in report.items() if key != "limits"}).items():
        table.add_row(name, "-" if value is None else str(value))
    console.print(table)
    for name, verdict in report["limits"].items():
        word = "at most" if verdict["kind"] == "most" else "at least"
        mark = "[green]ok[/]" if verdict["ok"] else "[red]MISSED[/]"
        console.print(f"{mark}  {name} {verdict['value']:g}, {word} {verdict['limit']:g} wanted", highlight=False)
