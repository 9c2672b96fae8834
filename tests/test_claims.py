"""Numbers in prose: recomputed from the result files that the sentence stands on."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import make_results
import pytest

from lerobot_adamanip.benchmark.report import BenchmarkReport, within
from lerobot_adamanip.catalog import CATEGORIES
from lerobot_adamanip.evaluation.metrics import Metrics, pool
from lerobot_adamanip.evaluation.paired import FAILED, OPENED, WITHIN_TRIES, PairedDifference
from lerobot_adamanip.evaluation.rates import Rate, show
from lerobot_adamanip.evaluation.record import read_log
from lerobot_adamanip.evaluation.results import read_result
from lerobot_adamanip.evaluation.text_format import percent_text

ROOT = Path(__file__).resolve().parents[1]
TEST = ROOT / "results" / "benchmark" / "test"
DOCUMENTS = {
    name: (ROOT / name).read_text(encoding="utf-8")
    for name in (
        "README.md",
        "docs/memory.md",
        "docs/sensing.md",
        "docs/lerobot_policies.md",
        "docs/tracks.md",
        "docs/twin.md",
    )
}
REPORTS: dict[str, BenchmarkReport] = {each.scale: each for each in make_results.benchmark_reports(ROOT / "results")}


def metrics(method: str, *categories: str, objects: str = "seen") -> Metrics:
    entries = REPORTS["test"].entries
    return pool(entries[method, category, objects].metrics for category in categories or CATEGORIES)


def counts(of: Metrics) -> str:
    assert of.success
    assert of.within_best_tries
    assert of.repeated
    return f"{of.success.count}, {of.within_best_tries.count}, {of.repeated.count} of {of.repeated.episodes}"


def something_new(method: str, failures: int) -> str:
    rate = (metrics(method).untried or {})[failures]
    return f"{rate.count:,} of {rate.episodes:,}"


MEMORY = ("dp3_adaptive", "without_memory")
"""The same weights."""


def gap(
    min_outcome: str, objects: str = "seen", categories: Sequence[str] = (), methods: tuple[str, str] = MEMORY
) -> PairedDifference:
    """Returns what the first method adds to the second in the main table."""
    report = REPORTS["test"]
    difference = report.paired(methods, categories or report.categories, objects, min_outcome)
    assert difference is not None
    return difference


def gain(
    min_outcome: str, objects: str = "seen", categories: Sequence[str] = (), methods: tuple[str, str] = MEMORY
) -> str:
    """Returns the same in points, with its interval."""
    difference = gap(min_outcome, objects, categories, methods)
    values = difference.difference, difference.low, difference.high
    return "{:+d} [{:+d}, {:+d}]".format(*(round(100 * value) for value in values))


def listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}"


THREE = ("bottle", "safe", "door")
TRIPLE = re.compile(r"\d+, \d+(?:,| and) \d+ of \d+")
"""Opened, within, repeated."""


def row(title: str, columns: Iterable[str]) -> str:
    return f"| {title} | {' | '.join(columns)} |"


def cells(scale: str, method: str, *categories: str) -> list[str]:
    return [counts(REPORTS[scale].entries[method, name, "seen"].metrics) for name in categories]


def named(method: str, *categories: str) -> str:
    columns = cells("control_rate", method, *categories)
    return "; ".join(f"{name}s {column}" for name, column in zip(categories, columns, strict=True))


def in_prose(counts_of_a_cell: str) -> str:
    return " and ".join(counts_of_a_cell.rsplit(", ", 1))


def in_memory() -> Iterator[str]:
    """Yields each piece of docs/memory.md that has counts of cells, made from those cells."""
    for name in CATEGORIES:
        yield row(name.replace("_", " "), (counts(metrics(method, name)) for method in MEMORY))
        yield row(name.replace("_", " "), (counts(metrics(method, name)) for method in ALONE))
    yield row("all", (counts(metrics(method)) for method in ALONE))
    for name in ("bottle", "pen", "safe", "window", "door", "lamp"):
        shorter = ("latest_1", "latest_2", "latest_4", "dp3_adaptive")
        yield row(name, (counts(of_training(method, name)) for method in shorter))
    for name in REPORTS["memories"].categories_with_results:
        yield row(name, (cells("memories", kind, name)[0] for kind in ("events", "window", "code", "none")))
    for title, end in (("without", ""), ("with `events`", "_events")):
        for policy in ("act", "diffusion"):
            yield row(title, cells("memories", f"{policy}{end}", *REPORTS["memories"].categories_with_results))
    two = cells("memories", "diffusion_window", *REPORTS["memories"].categories_with_results)
    yield row("two observations (`n_obs_steps=2`)", two)
    paper = (cells("memories", f"diffusion_of_paper{end}", "window")[0] for end in ("_events", ""))
    yield "events harm windows no longer: {} with, {} without.".format(*paper)
    yield f"#benchmark-scale-control_rate)): {named('dp3_adaptive_key_frames', *THREE)}."
    yield f"(`--mistakes 0.2`): {named('dp3_adaptive_key_frames_with_mistakes', *THREE[:2])};"
    for title, end in (("without", ""), ("with `events`", "_with_events")):
        yield row(title, cells("one_object", f"act{end}", *THREE[1:]))
    for end in ("", "_with_events"):
        yield f": {named(f'act_key_frames{end}', *THREE)}"
    yield row("without, on demonstrations with mistakes", cells("one_object", "act_on_mistakes", "safe"))
    dense = ("dp3_adaptive", "dp3_adaptive_without_memory", "dp3")
    for name in THREE[1:]:
        own, without, dp3 = (cells("control_rate", method, name)[0] for method in dense)
        yield f"{name.title()}s: {own} and {without}; DP3 {dp3}."
    without, dp3 = (in_prose(cells("control_rate", method, "bottle")[0]) for method in dense[1:])
    yield f"trained without it {without}; DP3 {dp3}."
    yield f"that training with its memory {in_prose(counts(of_training('dp3_adaptive')))}."


def in_policies() -> Iterator[str]:
    """Yields the same of docs/lerobot_policies.md."""
    methods = {
        "ACT | 10 Hz": "act",
        "Diffusion Policy | 10 Hz": "diffusion",
        "DP3 | 10 Hz": "dp3",
        "`dp3_adaptive`, preset `dense` | 10 Hz": "dp3_adaptive",
        "ACT | key frames": "act_key_frames",
        "DP3 | key frames": "dp3_key_frames",
        "`dp3_adaptive` | key frames": "dp3_adaptive_key_frames",
    }
    for line in DOCUMENTS["docs/lerobot_policies.md"].splitlines():
        titles = line.strip("| ").split(" | ")
        if method := methods.pop(" | ".join(titles[:2]), None):
            yield row(" | ".join(titles[:3]), cells("control_rate", method, *THREE))
    assert not methods


def test_counts_are_those_of_the_cells_that_they_stand_for() -> None:
    """Each piece is there; what is left of the documents without them has no counts of a cell."""
    pieces = {"docs/memory.md": [*in_memory()], "docs/lerobot_policies.md": [*in_policies()]}
    for name, text in DOCUMENTS.items():
        left = text
        for piece in pieces.get(name, []):
            assert piece in text
            left = left.replace(piece, "")
        assert TRIPLE.findall(left) == [], name


def test_the_memorys_gain_is_that_of_the_paired_scenes() -> None:
    within = gain(WITHIN_TRIES)
    assert f"{within.replace('+', '').replace(' ', ' points more within the tries ', 1)}" in DOCUMENTS["README.md"]
    each = listed([f"{100 * points:.0f}" for points in gap(WITHIN_TRIES).by_training.values()])
    assert f"({each} in three trainings)" in DOCUMENTS["README.md"]
    assert f"By training it is {each} points" in DOCUMENTS["docs/memory.md"]
    gaps = sorted((gap(WITHIN_TRIES, categories=[name]).difference, name) for name in CATEGORIES)
    (_, least), (_, most) = gaps[0], gaps[-1]
    ends = [gain(WITHIN_TRIES, categories=[name]) for name in (least, most)]
    chance = " (not beyond chance)" if gap(WITHIN_TRIES, categories=[least]).low <= 0 else ""
    assert f"from {ends[0]} at {least}s{chance} to {ends[1]} at {most}s" in DOCUMENTS["README.md"].replace("_", " ")
    text = f"is {within.replace(' ', ' points ', 1)} over the nine, in success {gain(OPENED)}"
    assert text in DOCUMENTS["docs/memory.md"]
    others = "; ".join(
        f"of {objects} objects {gain(WITHIN_TRIES, objects)} and {gain(OPENED, objects)}"
        for objects in ("unseen", "novel")
    )
    assert others in DOCUMENTS["docs/memory.md"]


def test_repeats_and_what_follows_a_failure_are_counted() -> None:
    repeated, removed = metrics("dp3_adaptive").repeated, metrics("without_memory").repeated
    assert repeated
    assert removed
    text = f"repeats {repeated.count:,} of {repeated.episodes:,} failed tries instead of {removed.count:,} of "
    text += f"{removed.episodes:,}"
    assert text in DOCUMENTS["README.md"]
    kept, lost = (
        [something_new(method, failures) for failures in (1, 2)] for method in ("dp3_adaptive", "without_memory")
    )
    text = f"another one in {kept[0]} cases, where two have failed in {kept[1]}; without the memory in "
    text += " and ".join(lost)
    assert text in DOCUMENTS["docs/memory.md"]
    ends = ("lamp", "safe"), tuple(name for name in CATEGORIES if name not in ("lamp", "safe"))
    shares = [(metrics("dp3_adaptive", *names).untried or {})[2] for names in ends]
    text = "after two it is {} of {} at lamps and safes, {} of {} at the seven others".format(
        *(number for share in shares for number in (share.count, share.episodes))
    )
    assert text in DOCUMENTS["docs/memory.md"]


def test_the_categories_that_fall_short_are_named() -> None:
    names = {name: metrics("dp3_adaptive", name).within_best_tries for name in CATEGORIES}
    low = [f"{name}s ({100 * rate.rate:.0f})" for name, rate in names.items() if rate and rate.rate and rate.rate < 0.9]
    assert f"below 90 % within the tries are {listed(low)}." in DOCUMENTS["README.md"]


def test_the_novel_objects_that_open_least_are_named() -> None:
    novel = {name: metrics("dp3_adaptive", name, objects="novel") for name in CATEGORIES}
    least = sorted((of.success.count, name) for name, of in novel.items() if of.success)[:3]
    named = [f"{name}s ({count})" for count, name in least]
    assert f"Novel {named[0]}, {named[1]} and {named[2]} open least." in DOCUMENTS["README.md"]
    rates = [(name, opened, novel[name].within_best_tries) for opened, name in least]
    both = ", ".join(f"{name}s {opened} and {within.count}" for name, opened, within in rates if within)
    assert f"opened and within the tries: {both}." in DOCUMENTS["docs/memory.md"]


def of_training(method: str, *categories: str, seed: int = 1001) -> Metrics:
    """Returns one training's metrics of all or some categories, seen objects."""
    chosen = categories or CATEGORIES
    rows = [read_result(TEST / f"{method}-{category}-seen-{seed}.json").rows[0] for category in chosen]
    return pool([row.metrics for row in rows])


def test_d435_is_compared_with_exact_clouds_of_the_same_training() -> None:
    methods = ("d435_calibrated", "d435", "dp3_adaptive")
    d435, alone, exact = (counts(of_training(method)).split(", ") for method in methods)
    text = f"it opens {d435[0]} of 900, within the tries {d435[1]}; without it {alone[0]} and {alone[1]}; with exact "
    text += f"clouds {exact[0]} and {exact[1]}."
    assert text in DOCUMENTS["docs/sensing.md"]


def test_errors_are_compared_with_their_correction() -> None:
    for error in ("mm20", "rough"):
        wrong, right = (counts(of_training(method)).split(", ") for method in (error, f"{error}_calibrated"))
        text = f"it opens {wrong[0]} of 900, within the tries {wrong[1]}; self-calibrated {right[0]} and {right[1]}"
        assert text in DOCUMENTS["docs/sensing.md"]
    for category in CATEGORIES:
        files = (TEST / f"{method}-{category}-seen-1001.json" for method in ("mm20_calibrated", "dp3_adaptive"))
        opened, exact = (read_result(file).rows[0].metrics.success.count for file in files)
        assert opened >= 0.95 * exact


@pytest.mark.parametrize(
    ("method", "title"),
    [
        ("with_no_repeat", "memory and rule"),
        ("dp3_adaptive", "memory alone (default)"),
        ("no_repeat", "rule alone"),
        ("without_memory", "neither"),
    ],
)
def test_memory_and_rule_have_the_counts_of_one_training(method: str, title: str) -> None:
    row = counts(of_training(method)).replace(", ", " | ")
    assert f"| {title} | {row} |" in DOCUMENTS["docs/memory.md"]


def test_the_rule_beside_and_instead_of_the_memory_differs_as_said() -> None:
    pairs = ("with_no_repeat", "dp3_adaptive"), ("dp3_adaptive", "no_repeat"), ("no_repeat", "without_memory")
    beside, instead, alone = (gain(WITHIN_TRIES, methods=pair) for pair in pairs)
    text = f"the rule changes {beside} beside the memory; the memory is {instead} better than the rule, and the rule "
    assert f"{text}{alone} better than neither" in DOCUMENTS["docs/memory.md"].replace(" points [", " [")


def test_shorter_memories_are_compared_as_said() -> None:
    places, shorter = ("bottle", "pen", "safe", "window", "door", "lamp"), ("latest_1", "latest_2", "latest_4")
    text = [gain(WITHIN_TRIES, categories=places, methods=("dp3_adaptive", method)) for method in shorter]
    said = f"all events are {text[0]} points better than the latest alone, {text[1]} than two and {text[2]} than four."
    assert said in DOCUMENTS["docs/memory.md"]


def test_a_policy_that_never_had_a_memory_is_behind_by_what_is_said() -> None:
    pair = "dp3_adaptive", "never_with_memory"
    always, never = (of_training(method) for method in pair)
    (kept, kept_within, *_), (opened, within, *_) = (counts(each).split(", ") for each in (always, never))
    assert always.repeated
    assert never.repeated
    text = f"opens {opened} of 900, {within} within the tries, and repeats {never.repeated.count:,} of "
    text += f"{never.repeated.episodes:,} failed tries; that training with its memory {kept}, {kept_within} and "
    assert f"{text}{always.repeated.count} of {always.repeated.episodes}." in DOCUMENTS["docs/memory.md"]
    within, opened = (gain(outcome, methods=pair).replace(" ", " points ", 1) for outcome in (WITHIN_TRIES, OPENED))
    text = f"the memory opens {within} more within the tries, in success {opened.replace(' points', '')}"
    assert text in DOCUMENTS["docs/memory.md"]
    assert f"is {within.replace('+', '').replace(' [', ' [', 1)} behind" in DOCUMENTS["README.md"]
    gaps = {name: gap(WITHIN_TRIES, categories=[name], methods=pair) for name in CATEGORIES}
    for name in CATEGORIES:
        assert (
            f"{name.replace('_', ' ')}s {gain(WITHIN_TRIES, categories=[name], methods=pair)}"
            in DOCUMENTS["docs/memory.md"]
        )
    larger = sorted(round(100 * each.difference) for each in gaps.values() if each.low > 0)
    assert (len(larger), larger[0], larger[-1]) == (6, 20, 50)
    assert "in six categories 20 to 50" in DOCUMENTS["README.md"]


ALONE = ("demonstrated", "demonstrated_without_memory", "demonstrated_with_no_repeat", "demonstrated_no_repeat")


def test_demonstrations_alone_are_compared_as_said() -> None:
    memory, text = (ALONE[0], ALONE[1]), DOCUMENTS["docs/memory.md"]
    gaps = {name: gap(WITHIN_TRIES, categories=[name], methods=memory) for name in CATEGORIES}
    assert min(each.low for each in gaps.values()) > 0
    ends = sorted(gaps, key=lambda name: gaps[name].difference)
    least, most = (
        f"{gain(WITHIN_TRIES, categories=[name], methods=memory)} at {name}s" for name in (ends[0], ends[-1])
    )
    within = gain(WITHIN_TRIES, methods=memory).replace(" ", " points ", 1)
    said = f"the memory is {within}, in success {gain(OPENED, methods=memory)}; within the tries it helps in each "
    assert f"{said}category, from {least} to {most}." in text
    corrected, alone = ("dp3_adaptive", ALONE[0]), metrics(ALONE[0])
    assert alone.within_best_tries
    opened = f"{alone.success.count} of {alone.success.episodes}, {alone.within_best_tries.count} within the tries"
    assert f"it opens {opened} (one training): there corrections add nothing" in DOCUMENTS["README.md"]
    assert f"{gain(WITHIN_TRIES, methods=corrected)} within the tries and {gain(OPENED, methods=corrected)} in" in text
    assert max(gap(outcome, methods=corrected).low for outcome in (WITHIN_TRIES, OPENED)) < 0
    repeated = [of.repeated for of in (of_training("dp3_adaptive"), alone)]
    both = " failed tries are repeated instead of ".join(
        f"{each.count} of {each.episodes}" for each in repeated if each
    )
    assert both in text
    rule, instead, other = (
        gain(WITHIN_TRIES, methods=pair) for pair in ((ALONE[2], ALONE[0]), (ALONE[0], ALONE[3]), (ALONE[3], ALONE[1]))
    )
    assert (
        f"{rule} within the tries; the memory is {instead} better than the rule alone, and this {other} better" in text
    )


def test_kinds_of_memory_are_compared_as_said() -> None:
    report, text = REPORTS["memories"], DOCUMENTS["docs/memory.md"]
    said = []
    for other, name in (("none", "none"), ("window", "a window"), ("code", "the code")):
        difference = report.paired(("events", other), report.categories_with_results, "seen", WITHIN_TRIES)
        assert difference is not None
        values = (round(100 * each) for each in (difference.difference, difference.low, difference.high))
        said.append("{:+d} points [{:+d}, {:+d}]".format(*values) + f" better than {name}")
    assert f"Within the tries, events are {listed(said)}." in text
    for policy, memory, words in (
        ("act", "act_events", "Over these, events are {} within the tries, and {} in success."),
        ("diffusion", "diffusion_events", "Over these, events are {} within the tries, and {} in success."),
        ("diffusion", "diffusion_window", "Two observations are {} within the tries, and {} in success."),
        ("diffusion_window", "diffusion_events", "Events instead of two observations are {} within the tries, and {}"),
    ):
        shown = []
        for outcome in (WITHIN_TRIES, OPENED):
            difference = report.paired((memory, policy), report.categories_with_results, "seen", outcome)
            assert difference is not None
            values = (round(100 * each) for each in (difference.difference, difference.low, difference.high))
            shown.append("{:+d} points [{:+d}, {:+d}]".format(*values))
        assert words.format(*shown) in text
    ends = [report.entries["diffusion_events", name, "seen"].metrics.failures for name in ("window", "door")]
    shut = [(sum(each.values()), each["key moved"]) for each in ends if each]
    said = "Of {} windows left shut, the handle has moved at {}, of {} doors at {}."
    assert said.format(*shut[0], *shut[1]) in text


@pytest.mark.parametrize(
    ("scale", "objects", "method"),
    [
        ("row", "unseen", "dp3_adaptive"),
        ("held_out_row", "unseen", "dp3_adaptive_corrected"),
        ("held_out_changing", "unseen", "dp3_adaptive_corrected"),
        ("real_sensors", "unseen", "dp3_adaptive_corrected"),
        ("real_sensors", "novel", "dp3_adaptive_corrected"),
        ("held_out_category", "unseen", "dp3_adaptive_elsewhere"),
        ("held_out_category_five", "unseen", "dp3_adaptive_elsewhere"),
        ("held_out_mechanism", "unseen", "dp3_adaptive"),
    ],
)
def test_tracks_are_measured_as_said(scale: str, objects: str, method: str) -> None:
    report, without = REPORTS[scale], f"{method}_without_memory"
    shares = [percent_text(report.mean(name, objects, within)) for name in ("expert", "luck", method, without)]
    difference = report.paired((method, without), report.categories, objects, WITHIN_TRIES)
    assert difference is not None
    values = (100 * value for value in (difference.difference, difference.low, difference.high))
    row = f"| `{scale}`, {objects} | {' | '.join(shares)} | {{:+.0f}} [{{:+.0f}}, {{:+.0f}}] |".format(*values)
    assert row in DOCUMENTS["docs/tracks.md"]


def test_held_out_categories_are_counted_as_said() -> None:
    def counts_of(scale: str, method: str) -> list[Metrics]:
        report = REPORTS[scale]
        return [report.entries[method, name, "unseen"].metrics for name in report.categories]

    five = [counts_of("held_out_category_five", f"dp3_adaptive_elsewhere{end}") for end in ("", "_without_memory")]
    for title, each in zip(("memory", "removed"), five, strict=True):
        cells = " | ".join(str(metrics.within_best_tries.count) for metrics in each if metrics.within_best_tries)
        assert f"| {title} | {cells} |" in DOCUMENTS["docs/tracks.md"]
    names = REPORTS["held_out_category_five"].categories
    ends = {name: metrics.failures or {} for name, metrics in zip(names, five[0], strict=True)}
    text = f"At windows and doors {ends['window']['no try']} and {ends['door']['no try']} of 60 episodes end without"
    assert text in DOCUMENTS["docs/tracks.md"]
    locked = [metrics.hidden["locked"] for metrics in five[0] if "locked" in metrics.hidden]
    text = f"{sum(each.count for each in locked)} of {sum(each.episodes for each in locked)} locked safes and"
    assert text in DOCUMENTS["docs/tracks.md"]
    zero = counts_of("held_out_category", "dp3_adaptive_elsewhere")
    first = [each.hidden["unlocked"] for each in zero if "unlocked" in each.hidden]
    opened = [f"{each.count} of {each.episodes} unlocked" for each in first]
    assert f"{opened[0]} safes and {opened[1]} microwaves open" in DOCUMENTS["docs/tracks.md"]
    repeated = pool(counts_of("held_out_mechanism", "dp3_adaptive")).repeated
    assert repeated is not None
    assert f"({repeated.count} of {repeated.episodes} failed tries after" in DOCUMENTS["docs/tracks.md"]


def test_self_calibration_adds_to_real_sensors_what_is_said() -> None:
    report, said = REPORTS["real_sensors"], []
    for objects in ("unseen", "novel"):
        pair = "dp3_adaptive_calibrated", "dp3_adaptive_corrected"
        difference = report.paired(pair, report.categories, objects, WITHIN_TRIES)
        assert difference is not None
        said.append([round(100 * each) for each in (difference.difference, difference.low, difference.high)])
    text = "adds {:+d} points [{:+d}, {:+d}] to `real_sensors` on unseen objects, ".format(*said[0])
    assert text + "and {:+d} [{:+d}, {:+d}] on novel ones".format(*said[1]) in DOCUMENTS["docs/tracks.md"]


def test_failures_in_a_row_are_counted_as_said() -> None:
    report = REPORTS["row"]
    rows = {name: report.entries["dp3_adaptive", name, "unseen"].metrics for name in report.categories}
    failures = {name: metrics.failures or {} for name, metrics in rows.items()}
    moved, vain, ajar, none = (
        sum(each[end] for each in failures.values()) for end in ("key moved", "tried in vain", "ajar", "no try")
    )
    count = sum(metrics.success.episodes for metrics in rows.values())
    text = f"Of {count} scenes of `row`, `dp3_adaptive` leaves {moved + vain + ajar + none} shut: in {moved} the key "
    text += f"alone has moved, in {vain} nothing has ({failures['safe']['tried in vain']} at safes), "
    text += f"in {ajar} the part is ajar, in {none} nothing was tried. "
    text += f"Pens open in {rows['pen'].success.count} of 60 scenes, windows in {rows['window'].success.count}."
    assert text in DOCUMENTS["docs/tracks.md"]


def test_the_readme_says_how_hard_a_row_and_an_unseen_category_are() -> None:
    row, other = REPORTS["row"], REPORTS["held_out_category"]
    opened = sorted(
        (rate.rate or 0, name)
        for name in row.categories
        if (rate := within(row.entries["dp3_adaptive", name, "unseen"].metrics))
    )
    least, most = (f"{100 * rate:.0f} % at {name}s" for rate, name in (opened[0], opened[-1]))
    means = (
        (row, "dp3_adaptive"),
        (row, "dp3_adaptive_without_memory"),
        (other, "dp3_adaptive_elsewhere"),
        (other, "luck"),
        (REPORTS["real_sensors"], "luck"),
    )
    shares = [report.mean(name, "unseen", within) for report, name in means]
    shown, removed, zero, luck, guess = (f"{100 * share:.0f}" for share in shares if share is not None)
    text = f"opens {shown} % of rows of three locks within the tries ({least}, {most}; one training), {removed} without"
    text += f" its memory. Of a category that it has not seen it opens {zero} %, where one guess opens {luck}."
    assert text in DOCUMENTS["README.md"]
    assert f"opens {guess} % within the tries by one guess" in DOCUMENTS["README.md"]


def test_locks_that_were_never_shown_are_counted_as_said() -> None:
    def of_lock(scale: str, value: str, end: str = "") -> Rate:
        report = REPORTS[scale]
        cells = (report.entries[f"dp3_adaptive_corrected{end}", name, "unseen"] for name in report.categories)
        return (pool(cell.metrics for cell in cells).hidden or {})[value]

    second, third = (of_lock("held_out_row", f"not {place}_pulls") for place in ("second", "third"))
    text = f"{second.count} of {second.episodes} whose second lock is not a pull, {third.count} of {third.episodes} "
    assert f"{text}whose third is not" in DOCUMENTS["docs/tracks.md"]
    (shut, removed), (open_, without) = (
        [of_lock("held_out_changing", value, end) for end in ("", "_without_memory")]
        for value in ("relocks", "not relocks")
    )
    text = f"where the lock shuts again {shut.count} of {shut.episodes} open ({removed.count} without the memory); "
    text += f"where it does not, which is an ordinary lock, {open_.count} of {open_.episodes} ({without.count})"
    assert text in DOCUMENTS["docs/tracks.md"]


def test_safes_are_counted_by_what_each_scene_needs() -> None:
    (best, own), (removed, removed_own) = (
        [rate.count for rate in (of.within_best_tries, of.within_own_tries) if rate]
        for of in (metrics(method, "safe") for method in MEMORY)
    )
    text = f"of 300 safes {own} open instead of {best}, without the memory {removed_own} instead of {removed}"
    assert text in DOCUMENTS["docs/memory.md"]
    first = metrics("dp3_adaptive", "safe").tried_locked_first
    assert first
    assert f"it pulls first at {first.count} of the {first.episodes} locked ones" in DOCUMENTS["docs/memory.md"]


def test_scenes_that_are_played_again_are_counted_as_said() -> None:
    report, text = REPORTS["again"], DOCUMENTS["docs/tracks.md"]
    each, removed = "dp3_adaptive_corrected", "dp3_adaptive_corrected_without_memory"
    titles = {
        "trained to remember, memory kept over three": "dp3_adaptive_over_episodes",
        "trained to remember, memory of each episode": "dp3_adaptive_of_each_episode",
        "demonstrations alone, memory of each episode": "dp3_adaptive_demonstrated",
        "corrected, memory of each episode": each,
        "corrected, memory removed": removed,
    }
    for title, method in titles.items():
        turns = [f"{percent_text(opened.rate)}, {show(tries)}" for opened, tries in report.by_turn(method, "unseen")]
        assert f"| {title} | {' | '.join(turns)} |" in text
    categories = ("bottle", "pen", "lamp", "window", "door", "safe", "microwave")
    failed = {
        name: report.entries["dp3_adaptive_over_episodes", name, "unseen"].results[0].rows[0].scene_tries
        for name in categories
    }
    turns = [", ".join(str(sum(map(int, tries[turn::3]))) for turn in range(3)) for tries in failed.values()]
    assert f"| | {' | '.join(categories)} |" in text
    assert f"| kept | {' | '.join(turns)} |" in text
    difference = report.paired((each, removed), report.categories, "unseen", OPENED)
    assert difference is not None
    values = (100 * value for value in (difference.difference, difference.low, difference.high))
    assert "Within an episode the memory is worth {:+.0f} points [{:+.0f}, {:+.0f}]".format(*values) in text


def test_the_twin_opens_what_the_evaluation_opened() -> None:
    (row,) = read_result(ROOT / "results" / "first_number.json").rows
    opened = {each.seed: each.success for each in read_log(ROOT / "results" / "twin" / "first_number.jsonl")}
    assert [opened[seed] for seed in sorted(opened)] == [outcome != FAILED for outcome in row.scene_outcomes]
    assert f"opens {sum(opened.values())} of {len(opened)} safes on the twin" in DOCUMENTS["docs/twin.md"]
