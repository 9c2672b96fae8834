"""Draws the pictures benchmark_*.png, of results/benchmark alone."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from PIL import Image

from lerobot_adamanip.benchmark.declaration import PAPER_TABLE, read_declaration
from lerobot_adamanip.benchmark.plots import plot_report
from lerobot_adamanip.benchmark.report import make_report
from lerobot_adamanip.evaluation.results import read_results

SHOWN: Mapping[str, tuple[str, str, str]] = {
    "control_rate": ("success", "control_rate.toml", "control_rate"),
    "control_rate_losses": ("losses", "control_rate.toml", "control_rate"),
    "paper": ("success", "", "paper_0_2"),
    "paper_losses": ("losses", "", "paper_0_2"),
    "success": ("success", "default_policy.toml", "test"),
    "tries": ("tries", "default_policy.toml", "test"),
}
"""Name -> plot of a report, declaration (none: beside the results) and scale."""
METHODS: Mapping[str, Sequence[str]] = {
    "test": (
        "dp3_adaptive",
        "without_memory",
        "never_with_memory",
        "demonstrated",
        "mm20",
        "mm20_calibrated",
        "d435",
    ),
}
"""Scale -> methods in its pictures; left out: all."""
WIDTH = 1500


def main(here: Path) -> None:
    """Writes the pictures into a folder."""
    for name, (plot, declared, scale) in SHOWN.items():
        folder = Path(__file__).resolve().parents[2] / "results" / "benchmark" / scale
        results = read_results(folder).values()
        chosen = [one for one in results if scale not in METHODS or (one.run and one.run.method in METHODS[scale])]
        declaration = read_declaration(PAPER_TABLE.with_name(declared) if declared else folder / "declaration.toml")
        report = make_report(chosen, declaration, scale)
        with tempfile.TemporaryDirectory() as folder:
            pictures = {path.stem: path for path in plot_report(report, Path(folder))}
            picture = Image.open(pictures[plot]).convert("RGB")
            picture.thumbnail((WIDTH, WIDTH), Image.Resampling.LANCZOS)
            picture.quantize(128).save(here / f"benchmark_{name}.png", optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parent)
