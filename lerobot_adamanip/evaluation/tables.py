"""Tables of metrics: Markdown for pages, and complete CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence

from lerobot_adamanip.evaluation.metrics import METRICS, Metrics
from lerobot_adamanip.evaluation.text_format import markdown_table


def metrics_table(
    titles: Sequence[str], rows: Iterable[tuple[Sequence[str], Metrics]], names: Iterable[str] = METRICS
) -> str:
    """Returns a table with one line of labels and metrics per row; empty if there is nothing to show.

    Args:
        titles: label titles.
        rows: labels and metrics.
        names: metric names; a metric that no row has is omitted.
    """
    found = list(rows)
    shown = [name for name in names if any(metrics.show(name) != "-" for _, metrics in found)]
    lines = [[*labels, *(metrics.show(name) for name in shown)] for labels, metrics in found]
    return markdown_table([*titles, *(METRICS[name].title for name in shown)], lines) if shown else ""


def csv_table(rows: Iterable[tuple[Mapping[str, object], Metrics]]) -> str:
    """Returns all metrics as CSV, one line per row: first the labels, then the metrics, rates with intervals."""
    lines = []
    for labels, metrics in rows:
        success = metrics.success
        counts = {"successes": success.count, "episodes": success.episodes}
        interval = {"low": f"{success.low:.4f}", "high": f"{success.high:.4f}"}
        shown = {name: metrics.show(name) for name in METRICS if name != "success"}
        lines.append({**labels, **counts, **interval, **shown})
    text = io.StringIO()
    columns = dict.fromkeys(name for line in lines for name in line)
    writer = csv.DictWriter(text, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()
