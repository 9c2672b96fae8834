"""`adamanip benchmark`: trains and tests the methods of a declaration and writes a results table."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot_adamanip.cli.benchmark_options import BenchmarkOptions


@dataclass
class Benchmark(BenchmarkOptions):
    """Trains and tests methods per category, and writes a table of their results next to the paper's.

    Runs `adamanip collect`, `lerobot-train` and `lerobot-eval`, --jobs at a time, and skips finished work. After
    Ctrl-C, a crash or a power cut, the same command resumes and gives the same results. See docs/benchmark.md.
    """

    def run(self) -> int:
        """Lists, runs or reports. Returns 0, 1 if a cell failed, or 130 after Ctrl-C."""
        from lerobot_adamanip.cli.benchmark_run import run_benchmark

        return run_benchmark(self)
