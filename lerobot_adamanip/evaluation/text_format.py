"""How tables tell things: categories, durations, shares with intervals, and tables of Markdown themselves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from lerobot_adamanip.evaluation.rates import Rate


def words(category: str) -> str:
    """Returns how tables and pictures call a category: ``coffee maker``."""
    return category.replace("_", " ")


def counted(count: int, noun: str) -> str:
    """Returns a number with its noun: ``1 cell``, ``2 cells``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def duration_text(seconds: float) -> str:
    """Returns ``90 s``, ``45 min`` or ``3.2 h``."""
    return (
        f"{seconds:.0f} s"
        if seconds < 120
        else f"{seconds / 60:.0f} min"
        if seconds < 7200
        else f"{seconds / 3600:.1f} h"
    )


def interval_text(share: Rate) -> str:
    """Returns ``36/40: 90 % [76.9, 96.0]``; ``-`` of no episodes."""
    if share.rate is None:
        return "-"
    return f"{share.count}/{share.episodes}: {100 * share.rate:.0f} % [{100 * share.low:.1f}, {100 * share.high:.1f}]"


def markdown_table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a table of Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (titles, ["---"] * len(titles), *rows))
