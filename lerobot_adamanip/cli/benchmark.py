"""`adamanip benchmark`: trains and tests the methods of a declaration and writes a results table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass
class BenchmarkCommand:
    """Trains and tests methods per category, and writes a table of their results next to the paper's.

    Runs `adamanip collect`, `lerobot-train` and `lerobot-eval`, --jobs at a time, and skips finished work. After
    Ctrl-C, a crash or a power cut, the same command resumes and gives the same results. See docs/benchmark.md.
    """

    scale: str | None = None
    """Size of the benchmark. smoke: a short test of every step. overfit: one bottle in one place. cpu: for two cores.
    paper: one pose of object, arm and camera, as in the paper. full: for a GPU. Default: cpu, if options such as
    --methods or --categories select some of its cells."""

    config: Path | None = None
    """TOML file that declares methods, demonstrations and scales. Default: the paper's table."""

    out: Path = Path("outputs/benchmark")
    """Output folder. Results are in OUT/SCALE/cells, the table in OUT/SCALE/report."""

    methods: str = ""
    """Run only these methods: names separated by commas, e.g. dp3_adaptive."""

    categories: str = ""
    """Run only these categories: names separated by commas, e.g. safe,door."""

    splits: str = ""
    """Run only tests on these object splits: seen, unseen, novel, separated by commas."""

    seeds: str = ""
    """Run only trainings with these seeds, separated by commas, e.g. 1000,1001."""

    list_cells: Annotated[bool, tyro.conf.arg(name="list")] = False
    """List the cells with their progress and run nothing."""

    report: bool = False
    """Write the table of the existing results and run nothing."""

    workers: int = 2
    """Number of processes that collect demonstrations. With --cluster: number of actors, 0 for one per CPU. Does not
    change a result."""

    jobs: int = 1
    """Number of parallel commands, which share the cores. Two trainings on one core each finish sooner than one after
    the other on two cores."""

    cluster: str | None = None
    """Ray cluster that collects demonstrations: HOST:PORT, auto or local. Trainings and tests run here."""

    insecure_cluster: bool = False
    """Use a cluster without a token: anyone who reaches its ports can run code on it."""

    json: bool = False
    """Print one JSON object. Progress goes to stderr."""

    def run(self) -> int:
        """Lists, runs or reports. Returns 1 if a cell failed, 130 after Ctrl-C, otherwise 0."""
        from lerobot_adamanip.cli.benchmark_run import run_benchmark

        return run_benchmark(self)
