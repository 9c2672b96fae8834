"""Tables of result files: the page docs/results.md, and the block in the README."""

from __future__ import annotations

import statistics
from collections.abc import Container, Iterable, Mapping, Sequence

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.evaluation.groups import OBJECT_SPLITS
from lerobot_adamanip.evaluation.metric_values import mean_length
from lerobot_adamanip.evaluation.metrics import METRICS, pool
from lerobot_adamanip.evaluation.provenance import machine_text
from lerobot_adamanip.evaluation.results import ResultFile, ResultRow
from lerobot_adamanip.evaluation.text_format import duration_text, markdown_table, words

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
_COLUMNS = ("wasted_tries", "repeated", "trained", "failed_at", "failures", "hidden")
"""Metrics in the tables of policies, with the minutes of their training; a new one is shown behind them."""
_ELSEWHERE = ("success", "key_frames", "failed_tries", "untried", "tried_locked_first")
"""Metrics that tables of policies show otherwise, or not at all."""


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
        told = (
            f" {result.rows[0].metrics.show('success')}"
            if len(result.rows) == 1
            else f"\n\n{result_table(result, brief=True)}"
        )
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
    columns = sorted(
        {(row.preset, row.subject, row.objects) for row in rows},
        key=lambda key: (*key[:2], OBJECT_SPLITS.index(key[2])),
    )
    several = len({preset for preset, _, _ in columns}) > 1
    titles = [f"{preset + ': ' if several else ''}{subject}, {objects}" for preset, subject, objects in columns]

    def cells(chosen: Sequence[ResultRow]) -> list[str]:
        found = [[row for row in chosen if (row.preset, row.subject, row.objects) == column] for column in columns]
        return [_expert_cell(each) if each else "-" for each in found]

    names = [name for name in CATEGORIES if any(row.category == name for row in rows)]
    lines = [[words(name), *cells([row for row in rows if row.category == name])] for name in names]
    return markdown_table(["", *titles], [*lines, ["all", *cells(rows)]] if len(names) > 1 else lines)


def _expert_cell(rows: Sequence[ResultRow]) -> str:
    metrics = pool(row.metrics for row in rows)
    frames = mean_length(metrics.key_frames) if len(rows) == 1 else None
    return f"{metrics.success.count}/{metrics.success.episodes}{'' if frames is None else f' ({frames:.1f})'}"


def _policy_table(rows: Sequence[ResultRow], brief: bool) -> str:
    splits = [split for split in OBJECT_SPLITS if any(row.objects == split for row in rows)]
    several = len({row.preset for row in rows}) > 1
    names = [*_COLUMNS, *(name for name in METRICS if name not in (*_COLUMNS, *_ELSEWHERE))]
    names = [name for name in names if not brief or name == "trained" or not METRICS[name].is_detail]
    lines = []
    for subject, preset in dict.fromkeys((row.subject, row.preset) for row in rows):
        of_policy = [row for row in rows if (row.subject, row.preset) == (subject, preset)]
        name = f"{subject} ({preset})" if several else subject
        categories = list(dict.fromkeys(row.category for row in of_policy))
        for category in categories:
            mine = [row for row in of_policy if row.category == category]
            cells = _by_split(mine, splits, "success")
            lines.append([name, words(category), *cells, *(_policy_cell(mine, splits, each) for each in names)])
        if len(categories) > 1:
            means = [_mean_success([row for row in of_policy if row.objects == each], categories) for each in splits]
            lines.append([name, f"mean of {len(categories)}", *means, *[""] * len(names)])
    metrics = ["trained" if name == "trained" else METRICS[name].title for name in names]
    titles = ["policy", "category", *(f"{split} objects" for split in splits), *metrics]
    kept = [place for place in range(len(titles)) if any(line[place] not in ("-", "") for line in lines)]
    return markdown_table([titles[place] for place in kept], [[line[place] for place in kept] for line in lines])


def _by_split(rows: Iterable[ResultRow], splits: Sequence[str], name: str) -> list[str]:
    by_split = {row.objects: row.metrics.show(name) for row in rows}
    return [by_split.get(split, "-") for split in splits]


def _policy_cell(rows: Sequence[ResultRow], splits: Sequence[str], name: str) -> str:
    """Returns a metric by split of objects, or of all objects together."""
    if name == "trained":
        known = [row.train_minutes for row in rows if row.train_minutes is not None]
        return f"{max(known):.0f} min" if known else "-"
    if not METRICS[name].by_objects:
        return pool(row.metrics for row in rows).show(name)
    cells = _by_split(rows, splits, name)
    return "-" if set(cells) == {"-"} else ", ".join(cells)


def _mean_success(rows: Sequence[ResultRow], categories: Sequence[str]) -> str:
    """Returns the mean of the categories' shares; nothing where one of them was not measured."""
    shares = [row.metrics.success.rate or 0.0 for row in rows]
    return f"{100 * sum(shares) / len(shares):.1f} %" if len(shares) == len(categories) else "-"


def _seeds_table(rows: Sequence[ResultRow]) -> str:
    """Returns mean, spread and each training's success; of wasted tries the same, of all splits of objects together."""
    splits = [split for split in OBJECT_SPLITS if any(row.objects == split for row in rows)]
    lines = []
    for category in dict.fromkeys(row.category for row in rows):
        mine = [row for row in rows if row.category == category]
        shares = [[100 * (row.metrics.success.rate or 0.0) for row in mine if row.objects == each] for each in splits]
        trainings = list(dict.fromkeys(row.subject for row in mine))
        pooled = [pool(row.metrics for row in mine if row.subject == name).wasted_tries for name in trainings]
        wasted = [round(each.value, 2) for each in pooled if each is not None and each.value is not None]
        cells = [_spread(values, ".1f", " %") for values in shares]
        lines.append([words(category), str(len(trainings)), *cells, _spread(wasted, ".2f", "")])
    return markdown_table(["category", "trainings", *(f"{split} objects" for split in splits), "wasted tries"], lines)


def _spread(values: Sequence[float], digits: str, unit: str) -> str:
    """Returns ``97.7 % ± 1.2 (97, 97, 99)``: mean, sample standard deviation, each; without it where there is one."""
    if not values:
        return "-"
    deviation = f" ± {statistics.stdev(values):{digits}}" if len(values) > 1 else ""
    each = ", ".join(f"{value:.4g}" for value in values)
    return f"{statistics.mean(values):{digits}}{unit}{deviation} ({each})"
