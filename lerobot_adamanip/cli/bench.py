"""`adamanip bench`: measures collection, simulation, observation, training and action on this machine."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.cli.arguments import Category, print_result
from lerobot_adamanip.evaluation.provenance import machine_class, present_origin
from lerobot_adamanip.evaluation.text_format import markdown_table
from lerobot_adamanip.util.errors import ConfigurationError

LIMITS = {
    "collection.episodes_per_minute": ("at least", 8.0),
    "observation_ms.raycast.total": ("at most", 15.0),
    "simulator.rendered_by_cast": ("at least", 7.0),
    "action_ms.fast.batch_1": ("at most", 100.0),
}
"""Expected values on two CPU cores without a GPU."""
Numbers = dict[str, Any]


@dataclass
class Bench:
    """Measure speed on this machine: medians of several repeats after a warm-up. Progress goes to stderr.

    Compared items are measured alternately, so ratios also hold on a busy machine; times do not.
    """

    quick: bool = False
    """Measure with fewer episodes and repeats."""

    workers: int = 2
    """Number of collection processes."""

    batch_size: int = 64
    """Batch size of a training step."""

    device: str = "cpu"
    """Device of the policy: cpu or cuda."""

    category: Category = "safe"
    """Category of the objects."""

    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> int:
        """Measures and prints. Returns 0 even if a limit is missed."""
        import torch

        wrong = self.device not in ("cpu", "cuda") or (self.device == "cuda" and not torch.cuda.is_available())
        if wrong or min(self.workers, self.batch_size) < 1:
            raise ConfigurationError(
                "Cannot measure that.",
                got=f"--device {self.device} --workers {self.workers} --batch-size {self.batch_size}",
                allowed="cpu, or cuda on a machine with a GPU; 1 or more",
                hint="adamanip bench --device cpu",
            )
        with contextlib.redirect_stdout(sys.stderr):
            report = add_limits(self._measure())
        rows = ([name, str(value)] for name, value in flatten(report).items())
        print_result(self.json, report, markdown_table(["", "value"], rows, align=True))
        return 0

    def _measure(self) -> Numbers:
        import torch

        from lerobot_adamanip.cli import bench_parts

        logging.getLogger().setLevel(logging.ERROR)
        begin, repeats = time.monotonic(), 3 if self.quick else 7
        machine = {**machine_class(), "load": round(os.getloadavg()[0], 2), "torch_threads": torch.get_num_threads()}
        results: Numbers = {"commit": present_origin().commit, "machine": machine}
        with tempfile.TemporaryDirectory(prefix="adamanip-bench-") as folder:
            root, per_object = Path(folder) / "demos", 1 if self.quick else 2
            policies = bench_parts.Policies(root, self.batch_size, self.device)
            parts: dict[str, Callable[[], Numbers]] = {
                "collection": lambda: bench_parts.collection(root, self.category, per_object, self.workers),
                "simulator": lambda: bench_parts.simulator(self.category, 3 * repeats),
                "observation_ms": lambda: bench_parts.observation(self.category, 3 * repeats),
                "training": lambda: policies.training(repeats),
                "action_ms": lambda: policies.action(3 * repeats),
            }
            for name, measure in parts.items():
                print(f"[{time.monotonic() - begin:5.0f} s] {name}", file=sys.stderr, flush=True)
                results[name] = measure()
        return {**results, "seconds": round(time.monotonic() - begin, 1)}


def add_limits(results: Numbers) -> Numbers:
    """Adds ``limits``: name -> value, limit, and whether the limit holds."""
    flat = flatten(results)
    limits = {
        name: {
            "value": flat[name],
            "limit": f"{side} {bound:g}",
            "ok": flat[name] >= bound if side == "at least" else flat[name] <= bound,
        }
        for name, (side, bound) in LIMITS.items()
    }
    return {**results, "limits": limits}


def flatten(results: Numbers, prefix: str = "") -> dict[str, Any]:
    """Returns nested results with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in results.items():
        flat |= flatten(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat
