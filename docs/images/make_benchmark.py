"""Draws benchmark_success.png and benchmark_trials.png, of results/benchmark/cpu alone."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from lerobot_adamanip.benchmark.declaration import read_declaration
from lerobot_adamanip.benchmark.report import make_report
from lerobot_adamanip.benchmark.report_plots import plot_report
from lerobot_adamanip.benchmark.result import read_cells
from lerobot_env_adamanip.fingerprint import present_fingerprints

SCALE, SHOWN, WIDTH = "cpu", ("success", "trials"), 1500


def main(here: Path) -> None:
    """Writes the pictures into a folder."""
    results = read_cells(here.parents[1] / "results" / "benchmark" / SCALE)
    report = make_report(results, read_declaration(), SCALE, present_fingerprints())
    with tempfile.TemporaryDirectory() as folder:
        pictures = {path.stem: path for path in plot_report(report, Path(folder))}
        for name in SHOWN:
            picture = Image.open(pictures[name]).convert("RGB")
            picture.thumbnail((WIDTH, WIDTH), Image.Resampling.LANCZOS)
            picture.quantize(128).save(here / f"benchmark_{name}.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parent)
