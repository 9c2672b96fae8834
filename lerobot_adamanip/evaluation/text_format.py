"""Text formatting of reports and pages: Markdown tables, CSV, rates with intervals, durations."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence

from lerobot_adamanip.evaluation.rates import Rate


def words(category: str) -> str:
    """Returns a category as words: ``coffee maker``."""
    return category.replace("_", " ")


def counted(count: int, noun: str) -> str:
    """Returns a number with its noun: ``1 cell``, ``2 cells``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def duration_text(seconds: float) -> str:
    """Returns ``90 s``, ``45 min`` or ``3.2 h``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def interval_text(share: Rate) -> str:
    """Returns ``36/40: 90 % [76.9, 96.0]``; ``-`` without episodes."""
    if share.rate is None:
        return "-"
    return f"{share.count}/{share.episodes}: {100 * share.rate:.0f} % [{100 * share.low:.1f}, {100 * share.high:.1f}]"


def percent_text(share: float | None) -> str:
    """Returns ``90.5 %``; ``-`` for None."""
    return "-" if share is None else f"{100 * share:.1f} %"


def markdown_table(titles: Sequence[str], rows: Iterable[Sequence[str]], *, align: bool = False) -> str:
    """Returns a Markdown table; ``align`` pads its columns for a terminal."""
    lines = [list(titles), *map(list, rows)]
    if not align:
        lines.insert(1, ["---"] * len(titles))
        return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    lines.insert(1, ["-" * width for width in widths])
    padded = ([cell.ljust(width) for cell, width in zip(cells, widths, strict=True)] for cells in lines)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in padded)


def csv_table(lines: Sequence[Mapping[str, object]]) -> str:
    """Returns lines as CSV with a column for each name that occurs."""
    text = io.StringIO()
    columns = dict.fromkeys(name for line in lines for name in line)
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()
