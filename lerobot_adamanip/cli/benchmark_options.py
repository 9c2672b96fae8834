"""Options of `adamanip benchmark`, apart from its work: the help shall import nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

DEFAULT_SCALE = "cpu"


@dataclass
class BenchmarkOptions:
    """What to run, and how; see `lerobot_adamanip.cli.benchmark.Benchmark`."""

    scale: str | None = None
    """How much of everything: smoke shows that all of it runs, cpu is for two cores, full for a GPU. May be left out,
    for cpu, where --methods or --categories choose some of its cells."""

    config: Path | None = None
    """Declaration of methods, demonstrations and scales (TOML), instead of the paper's table."""

    out: Path = Path("outputs/benchmark")
    """Folder of everything it makes; results are in OUT/SCALE/cells, the table in OUT/SCALE/report."""

    methods: str = ""
    """Only these: names separated by commas."""

    categories: str = ""
    """Only these: names separated by commas."""

    splits: str = ""
    """Only tests on these objects: of seen, unseen, novel, separated by commas."""

    seeds: str = ""
    """Only trainings of these seeds, separated by commas."""

    list_cells: Annotated[bool, tyro.conf.arg(name="list")] = False
    """Only list the cells, and how far each is; run nothing."""

    report: bool = False
    """Only write the table, of the results there are; run nothing."""

    workers: int = 2
    """Processes that collect demonstrations; with --cluster actors, 0: one per CPU. Does not change a result."""

    jobs: int = 1
    """Commands that run at once, each with its share of the cores: two trainings on one core each take less time than
    one after the other on two."""

    cluster: str | None = None
    """Ray cluster that collects demonstrations: HOST:PORT, auto or local. Trainings and tests run here."""

    insecure_cluster: bool = False
    """Use a cluster that demands no token: anyone who reaches its ports runs code on it."""

    json: bool = False
    """Print one JSON object. Progress goes to stderr."""
