"""Result files as tables of Markdown: the page docs/results.md and the block in the README."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Container, Iterable, Mapping, Sequence

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.failed_tries import IN_VAIN
from lerobot_adamanip.evaluation.failures import CAUSES, failures_text
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.rates import rate
from lerobot_adamanip.evaluation.result_rows import OBJECT_SPLITS, ResultRow
from lerobot_adamanip.evaluation.results import ResultFile
from lerobot_adamanip.evaluation.text_format import duration_text, interval_text, markdown_table, words

START, END = "<!-- results -->", "<!-- /results -->"
INTRODUCTION = """# Results

Generated from the files in `results/` by `python scripts/make_results.py`; a test compares the two. Each table says
with which command, commit and seeds it was measured, and by which code: the *fingerprint* is a hash of all that decides
how an episode comes out (contract, mechanisms, objects, simulator; experts, where they acted). Only tables of the
present fingerprint stand in the README. Intervals are Wilson's, 95 %; in brackets behind a count: mean key frames of a
success. *Wasted tries*: failed ones per success, beyond those that the best strategy needs that sees nothing hidden
either. *Failed tries repeated*: unchanged, of those that another try followed; both are told for the kinds of objects
in the order of their columns. *A success's failed tries*: at a part that opens and was held, at a key (knob, cap,
lever) that did not turn that way, or where a joint that had gone this way went no further, as at its stop, which nobody
sees. *How failures ended*: without any try, without a joint that moved, with the key moved, or ajar. Behind ± is the
sample standard deviation of trainings that differ in their seed alone.
"""
NOTHING = "No number is shown here: none has been measured with the present code yet."
_CONTINUOUS = ("<", ">=")
_LONG_TITLES = ("a success's failed tries", "how failures ended", "by what is hidden")
"""Columns at the end of a policy's table that a brief one does without."""
_POLICY_TITLES = ("wasted tries", "failed tries repeated", "trained", *_LONG_TITLES)


def results_page(results: Mapping[str, ResultFile], present: Container[str]) -> str:
    """Returns docs/results.md.

    Args:
        results: by file name.
        present: fingerprints of the present code: with experts, and without.
    """
    parts = [INTRODUCTION]
    fresh = {name: result for name, result in results.items() if result.fingerprint in present}
    stale = {name: result for name, result in results.items() if result.fingerprint not in present}
    if not fresh:
        parts.append(f"{NOTHING}\n")
    for name, result in (*fresh.items(), *stale.items()):
        parts.append(f"## {_heading(result)}\n")
        if result.fingerprint not in present:
            parts.append(
                f"**Of another fingerprint**, `{result.fingerprint}` (version {result.version}): "
                "not what the present code would give.\n"
            )
        parts.append(f"{result_table(result)}\n")
        parts.append(f"{source_line(name, result)}\n")
    return "\n".join(parts)


def readme_block(results: Mapping[str, ResultFile], present: Container[str], more: Iterable[str] = ()) -> str:
    """Returns what stands between the README's marks, both included: the paper's preset, of the present fingerprint.

    What policies were chosen by is no number to show there: validation scenes stand on the page alone. So do experts,
    once a policy was measured. A single number needs no table. ``more`` are further lines to show, unless empty.
    """
    known = (result for result in results.values() if result.fingerprint in present and result.scenes != "validation")
    fresh = [result for result in known if any(row.preset == "paper" for row in result.rows)]
    by_kind = {kind: [result for result in fresh if result.kind == kind] for kind in ("policy", "expert")}
    fresh = by_kind["policy"] or by_kind["expert"]
    parts = [START]
    for result in fresh:
        told = f" {_success(result.rows[0])}" if len(result.rows) == 1 else f"\n\n{result_table(result, brief=True)}"
        parts.append(f"{_heading(result)} ({_scenes(result)}):{told}\n")
    parts += [f"{line}\n" for line in more if line]
    parts.append("Commands, commits and hidden values: [results](docs/results.md)." if len(parts) > 1 else NOTHING)
    return "\n".join([*parts, END])


def with_block(document: str, block: str) -> str:
    """Returns a document with the block between its marks replaced; ValueError if it has not exactly one."""
    before, start, rest = document.partition(START)
    _, end, after = rest.partition(END)
    if not start or not end or START in rest or END in after:
        raise ValueError(f"not exactly one block {START} ... {END}")
    return before + block + after


def result_table(result: ResultFile, *, brief: bool = False) -> str:
    """Returns a result's table: a row per category, and for policies one per subject and category.

    Args:
        result: what to tell.
        brief: without what failed, how failures ended and what was hidden.
    """
    if result.kind == "seeds":
        return _seeds_table(result.rows)
    return _expert_table(result.rows) if result.kind == "expert" else _policy_table(result.rows, brief)


def source_line(name: str, result: ResultFile) -> str:
    """Returns what a table was measured with."""
    commit = "no commit" if result.commit is None else f"commit {result.commit[:10]}"
    commit += " with changes" if result.changed else ""
    taken = "" if result.seconds is None else f", {duration_text(result.seconds)}"
    made = f"{commit}, version {result.version}, fingerprint `{result.fingerprint}`"
    scenes = f"{_scenes(result)}, seeds {result.seeds[0]} to {result.seeds[1]}"
    return f"`{result.command}`; {made}; {scenes}; {machine_text(result.machine)}{taken}. From `results/{name}`."


def _heading(result: ResultFile) -> str:
    return result.title[:1].upper() + result.title[1:]


def _scenes(result: ResultFile) -> str:
    return "scenes of no split" if result.scenes is None else f"{result.scenes} scenes"


def _expert_table(rows: Sequence[ResultRow]) -> str:
    columns = sorted({(row.preset, row.subject, row.objects) for row in rows}, key=_column_order)
    several = len({preset for preset, _, _ in columns}) > 1
    titles = [f"{preset + ': ' if several else ''}{subject}, {objects}" for preset, subject, objects in columns]
    names = [name for name in CATEGORIES if any(row.category == name for row in rows)]
    lines = [
        (name, [_cell([row for row in rows if row.category == name], column) for column in columns]) for name in names
    ]
    if len(names) > 1:
        lines.append(("all", [_cell(rows, column) for column in columns]))
    return markdown_table(["", *titles], [[words(name), *cells] for name, cells in lines])


def _cell(rows: Iterable[ResultRow], column: tuple[str, str, str]) -> str:
    chosen = [row for row in rows if (row.preset, row.subject, row.objects) == column]
    if not chosen:
        return "-"
    frames = f" ({chosen[0].key_frames:.1f})" if len(chosen) == 1 and chosen[0].key_frames is not None else ""
    return f"{sum(row.successes for row in chosen)}/{sum(row.episodes for row in chosen)}{frames}"


def _column_order(column: tuple[str, str, str]) -> tuple[str, str, int]:
    return column[0], column[1], OBJECT_SPLITS.index(column[2])


def _policy_table(rows: Sequence[ResultRow], brief: bool) -> str:
    splits = [split for split in OBJECT_SPLITS if any(row.objects == split for row in rows)]
    several = len({row.preset for row in rows}) > 1
    lines = []
    for subject, preset in dict.fromkeys((row.subject, row.preset) for row in rows):
        of_policy = [row for row in rows if (row.subject, row.preset) == (subject, preset)]
        name = f"{subject} ({preset})" if several else subject
        categories = list(dict.fromkeys(row.category for row in of_policy))
        for category in categories:
            mine = [row for row in of_policy if row.category == category]
            by_split = {row.objects: row for row in mine}
            cells = [_success(by_split[split]) if split in by_split else "-" for split in splits]
            lines.append(
                [
                    name,
                    words(category),
                    *cells,
                    _by_split(_wasted, by_split, splits),
                    _by_split(_repeated, by_split, splits),
                    _minutes(mine),
                    _in_vain(mine),
                    _failures(mine),
                    _hidden(mine),
                ]
            )
        if len(categories) > 1:
            means = [
                _mean_success([row for row in of_policy if row.objects == split], len(categories)) for split in splits
            ]
            lines.append([name, f"mean of {len(categories)}", *means, *[""] * len(_POLICY_TITLES)])
    titles = ["policy", "category", *(f"{split} objects" for split in splits), *_POLICY_TITLES]
    # What nobody measured needs no column.
    last = len(titles) - (len(_LONG_TITLES) if brief else 0)
    kept = [place for place in range(last) if any(line[place] not in ("-", "") for line in lines)]
    return markdown_table([titles[place] for place in kept], [[line[place] for place in kept] for line in lines])


def _seeds_table(rows: Sequence[ResultRow]) -> str:
    """Returns mean, spread and each training's success; of wasted tries the same, of all splits of objects together."""
    splits = [split for split in OBJECT_SPLITS if any(row.objects == split for row in rows)]
    lines = []
    for category in dict.fromkeys(row.category for row in rows):
        mine = [row for row in rows if row.category == category]
        shares = [[100 * row.successes / row.episodes for row in mine if row.objects == split] for split in splits]
        names = dict.fromkeys(row.subject for row in mine)
        of_training = [[row for row in mine if row.subject == name] for name in names]
        wasted = [tries for tries in map(_mean_wasted, of_training) if tries is not None]
        cells = [_spread(values, ".1f", " %") for values in shares]
        lines.append([words(category), str(len(of_training)), *cells, _spread(wasted, ".2f", "")])
    return markdown_table(["category", "trainings", *(f"{split} objects" for split in splits), "wasted tries"], lines)


def _spread(values: Sequence[float], digits: str, unit: str) -> str:
    """Returns ``97.7 % ± 1.2 (97, 97, 99)``: mean, sample standard deviation, each; without it where there is one."""
    if not values:
        return "-"
    deviation = f" ± {statistics.stdev(values):{digits}}" if len(values) > 1 else ""
    each = ", ".join(f"{value:.4g}" for value in values)
    return f"{statistics.mean(values):{digits}}{unit}{deviation} ({each})"


def _mean_success(rows: Sequence[ResultRow], categories: int) -> str:
    """Returns the mean of the categories' shares; nothing where one of them was not measured."""
    shares = [row.successes / row.episodes for row in rows]
    return f"{100 * sum(shares) / len(shares):.1f} %" if len(shares) == categories else "-"


def _wasted(rows: Iterable[ResultRow]) -> str:
    """Returns tries wasted per success."""
    tries = _mean_wasted(rows)
    return "-" if tries is None else f"{tries:.2f}"


def _mean_wasted(rows: Iterable[ResultRow]) -> float | None:
    """Returns tries wasted per success, to two digits; None if nobody counted them, or nothing succeeded."""
    counted = [(row.wasted_tries, row.successes) for row in rows if row.wasted_tries is not None and row.successes]
    if not counted:
        return None
    return round(sum(tries * successes for tries, successes in counted) / sum(each for _, each in counted), 2)


def _by_split(told: Callable[[Iterable[ResultRow]], str], rows: Mapping[str, ResultRow], splits: Sequence[str]) -> str:
    """Returns what is told of each split's row, in order; ``-`` if there is nothing to tell of any."""
    each = [told([rows[split]]) if split in rows else "-" for split in splits]
    return "-" if set(each) == {"-"} else ", ".join(each)


def _repeated(rows: Iterable[ResultRow]) -> str:
    """Returns how many failed tries were repeated unchanged."""
    counted = [row.repeated for row in rows if row.repeated is not None]
    return f"{sum(count for count, _ in counted)}/{sum(tries for _, tries in counted)}" if counted else "-"


def _minutes(rows: Iterable[ResultRow]) -> str:
    """Returns how long the policy was trained; its rows say the same."""
    known = [row.train_minutes for row in rows if row.train_minutes is not None]
    return f"{max(known):.0f} min" if known else "-"


def _in_vain(rows: Iterable[ResultRow]) -> str:
    """Returns what failed per success, of all splits of objects together."""
    counted = [(row.in_vain, row.successes) for row in rows if row.in_vain is not None and row.successes]
    if not counted:
        return "-"
    successes = sum(each for _, each in counted)
    means = {kind: sum(tries.get(kind, 0) for tries, _ in counted) / successes for kind in IN_VAIN}
    return ", ".join(f"{kind} {mean:.2f}" for kind, mean in means.items() if mean >= 0.005) or "none"


def _failures(rows: Iterable[ResultRow]) -> str:
    """Returns how failed episodes had ended, of all splits of objects together."""
    counted = [row.failures for row in rows if row.failures is not None]
    found = {cause: sum(each.get(cause, 0) for each in counted) for cause in CAUSES}
    return failures_text({cause: count for cause, count in found.items() if count}) if counted else "-"


def _success(row: ResultRow) -> str:
    return interval_text(rate(row.successes, row.episodes))


def is_half_of_range(name: str) -> bool:
    """Whether a hidden value's name is that of a half of a continuous range, whose boundary is one evaluation's own."""
    return any(sign in name for sign in _CONTINUOUS)


def _hidden(rows: Iterable[ResultRow]) -> str:
    """Returns counts by hidden value, of all splits of objects together; halves of continuous ranges are left out."""
    counts: dict[str, tuple[int, int]] = {}
    for row in rows:
        for name, (count, episodes) in (row.hidden or {}).items():
            if not is_half_of_range(name):
                before = counts.get(name, (0, 0))
                counts[name] = (before[0] + count, before[1] + episodes)
    return ", ".join(f"{name} {count}/{episodes}" for name, (count, episodes) in sorted(counts.items())) or "-"
