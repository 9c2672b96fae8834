"""`adamanip benchmark`: train and test the methods of a declaration, and write their table."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot_adamanip.cli.benchmark_options import BenchmarkOptions


@dataclass
class Benchmark(BenchmarkOptions):
    """Trains and tests methods category by category, and writes a table of them, beside the paper's.

    Runs `adamanip collect`, `lerobot-train` and `lerobot-eval`, --jobs at a time, and only what is missing: after
    Ctrl-C, a crash or a power cut the same command goes on, and comes to the same results. See docs/benchmark.md.
    """

    def run(self) -> int:
        """Lists, runs or reports; 0, 1 if a cell failed, 130 after Ctrl-C."""
        from lerobot_adamanip.cli.benchmark_run import run_benchmark

        return run_benchmark(self)
