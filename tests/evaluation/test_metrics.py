"""Groups, tries and repeats: laws, not values."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import record

from lerobot_adamanip.evaluation.metrics import METRICS, Metrics, measure, pool
from lerobot_adamanip.evaluation.plots import cumulative_rates
from lerobot_adamanip.evaluation.rates import SUCCESS_KEYS
from lerobot_adamanip.evaluation.record import (
    EpisodeRecord,
    first_episodes,
    hidden_boundaries,
    split_evaluations,
    without_repeats,
)
from lerobot_adamanip.evaluation.report import ALL, Group, compare, group_records, summarise, worth_showing

OBJECTS = ["safe_000", "safe_035", "safe_036", "safe_n002", "lamp_003", "bottle_001", "microwave_000", "door_100"]
HIDDEN = {
    "safe": st.fixed_dictionaries(
        {"locked": st.booleans(), "direction": st.sampled_from([-1, 1]), "knob_range": st.floats(1, 2)}
    ),
    "lamp": st.fixed_dictionaries({"mode": st.integers(0, 2)}),
    "microwave": st.fixed_dictionaries({"locked": st.booleans()}),
}
TURNED = st.fixed_dictionaries({"direction": st.sampled_from([-1, 1]), "turn_range": st.floats(0.5, 2.5)})


@st.composite
def any_record(draw: st.DrawFn) -> EpisodeRecord:
    object_id = draw(st.sampled_from(OBJECTS))
    hidden = draw(HIDDEN.get(object_id.rsplit("_", 1)[0], TURNED))
    return record(
        seed=draw(st.integers(0, 12)),
        object_id=object_id,
        hidden_state=hidden,
        success=draw(st.booleans()),
        key_frames=draw(st.integers(8, 45)),
        blocked_pulls=draw(st.integers(0, 4)),
        key_moved=draw(st.booleans()),
        wrong_turns=draw(st.integers(0, 2)),
    )


RECORDS = st.lists(any_record(), max_size=60)


@given(RECORDS)
def test_every_kind_of_group_parts_the_episodes_and_their_successes(records: list[EpisodeRecord]) -> None:
    summary = summarise(records)
    assert summary.episodes + summary.repeats == len(records)
    assert summary.overall.success.episodes == summary.episodes
    for by in ("category", "objects", "category and objects", "scenes"):
        parts = [result.success for group, result in summary.groups.items() if group.by == by]
        assert sum(part.episodes for part in parts) == summary.episodes
        assert sum(part.count for part in parts) == summary.overall.success.count
    assert sum(result.episodes for result in summary.objects.values()) == summary.episodes
    assert sum(result.count for result in summary.objects.values()) == summary.overall.success.count
    assert next(iter(summary.groups)) == ALL


def test_what_is_hidden_is_what_is_grouped_by() -> None:
    records = [
        record(object_id="safe_000", locked=True), record(object_id="microwave_000"),
        record(object_id="lamp_000", hidden_state={"mode": 2}),
        record(object_id="bottle_000", hidden_state={"direction": -1, "turn_range": 1.0}),
        record(object_id="bottle_001", hidden_state={"direction": 1, "turn_range": 1.5}),
    ]  # fmt: skip
    hidden = [group.name for group in group_records(records) if group.by == "hidden"]
    assert hidden == [
        "bottle: direction +1",
        "bottle: direction -1",
        "bottle: turn_range < 1.25",
        "bottle: turn_range >= 1.25",
        "lamp: mode 2",
        "microwave: unlocked",
        "safe: direction +1",
        "safe: knob_range >= 1.2",
        "safe: locked",
    ]


@given(RECORDS)
def test_a_continuous_range_is_halved(records: list[EpisodeRecord]) -> None:
    boundaries = hidden_boundaries((each.category, each.hidden_state) for each in records)
    for (category, name), boundary in boundaries.items():
        values = [each.hidden_state[name] for each in records if each.category == category]
        assert sum(value < boundary - 0.02 for value in values) <= len(values) / 2
        assert sum(value > boundary + 0.02 for value in values) <= len(values) / 2


def test_groups_that_only_repeat_another_are_not_shown() -> None:
    safes = [record(), record(object_id="safe_036", seed=2)]
    assert [group.by for group in worth_showing(group_records(safes)) if group.by != "hidden"] == [
        "all",
        "objects",
        "objects",
    ]
    both = [*safes, record(object_id="lamp_000", seed=1_000_001)]
    assert {group.by for group in worth_showing(group_records(both))} == {
        "all",
        "category",
        "objects",
        "category and objects",
        "scenes",
        "hidden",
    }


@given(RECORDS)
def test_an_episode_counts_once_and_the_last_record_wins(records: list[EpisodeRecord]) -> None:
    kept = without_repeats(records)
    assert max(Counter(r.identity for r in kept).values(), default=1) == 1
    assert {r.identity for r in kept} == {r.identity for r in records}
    assert all(kept_one is [r for r in records if r.identity == kept_one.identity][-1] for kept_one in kept)
    assert summarise([*records, *records]).overall == summarise(records).overall
    assert summarise([record(), record(object_id="safe_001"), record(locked=True)]).episodes == 3


def test_two_evaluations_in_one_log_are_told_apart() -> None:
    log = [record(seed=1), record(seed=1, run_id="b"), record(seed=2), record(seed=2, run_id="b", success=False)]
    first, second = split_evaluations(log)
    assert [each.seed for each in first] == [each.seed for each in second] == [1, 2]
    assert summarise(first).overall.success.count == 2
    assert summarise(second).overall.success.count == 1
    assert len(split_evaluations([record(evaluation=k) for k in range(3)])) == 3


def wasted(*records: EpisodeRecord) -> float | None:
    found = measure(records).wasted_tries
    return None if found is None else found.value


def test_the_best_strategy_wastes_nothing_and_each_further_try_one() -> None:
    # Of two locked safes, the best strategy turns one knob the wrong way first.
    lucky = record(seed=2, locked=True, blocked_pulls=1, key_moved=True)
    unlucky = record(seed=3, locked=True, blocked_pulls=1, key_moved=True, wrong_turns=1)
    assert wasted(record(), lucky, unlucky) == pytest.approx(0)
    for more in ({"blocked_pulls": 1}, {"key_moved": True}, {"wrong_turns": 1}):
        assert wasted(record(**more), record()) == pytest.approx(0.5)


@given(RECORDS)
def test_failed_episodes_change_no_mean_of_tries(records: list[EpisodeRecord]) -> None:
    idle = record(seed=99, locked=True, success=False, key_frames=45, try_sequence=())
    assert wasted(idle) is None
    for name in ("wasted_tries", "failed_tries", "failed_at"):
        assert measure([*records, idle]).show(name) == measure(records).show(name)


@given(st.lists(any_record(), min_size=1, max_size=30), st.integers(0, 30))
def test_metrics_come_back_from_json_and_parts_add_up(records: list[EpisodeRecord], place: int) -> None:
    whole = measure(records)
    read = Metrics.from_json("metrics", json.loads(json.dumps(whole.to_json())))
    pooled = pool(measure(part) for part in (records[:place], records[place:]))
    for other in (read, pooled):
        for name in METRICS:
            if name != "hidden" or other is read:  # continuous values of parts are halved elsewhere
                assert other.show(name) == whole.show(name)
    without = {key: value for key, value in whole.to_json().items() if key not in SUCCESS_KEYS}
    assert Metrics.from_json("metrics", without) == read, "LeRobot's keys are for other readers"
    earlier = {key: value for key, value in whole.to_json().items() if key != "untried"}
    assert Metrics.from_json("metrics", earlier).show("untried") == "-", "results from before a metric was there"


@pytest.mark.parametrize(
    "changes",
    [
        {"successes": 4}, {"episodes": 0}, {"hidden": {"locked": [2, 9]}}, {"repeated": [4, 3]}, {"repeated": 3},
        {"failures": {"ajar": 7}}, {"key_frames": {"9": 9}}, {"wasted_tries": [1, 2]}, {"failed_at": "much"},
        {"hidden": {"a | b": [1, 1]}}, {"tries": 3}, {"more": 1},
    ],
    ids=str,
)  # fmt: skip
def test_metrics_that_cannot_be_are_refused(changes: dict[str, Any]) -> None:
    good = measure([record(), record(seed=2), record(seed=3, success=False)]).to_json()
    with pytest.raises(ValueError):  # noqa: PT011  (each has its own text)
        Metrics.from_json("metrics", {**good, **changes})


@given(RECORDS)
def test_the_curve_ends_at_the_overall_rate(records: list[EpisodeRecord]) -> None:
    rates = cumulative_rates(records)
    assert [r.episodes for r in rates] == list(range(1, summarise(records).episodes + 1))
    if rates:
        assert rates[-1] == summarise(records).overall.success


@given(st.integers(1, 40), st.integers(1, 7), st.randoms())
def test_the_first_episodes_are_those_that_lerobot_counts(episodes: int, batch: int, chance: object) -> None:
    """As `lerobot.scripts.lerobot_eval.eval_policy` seeds and counts, in whatever order the processes write."""
    batches = episodes // batch + (episodes % batch != 0)
    ran = [
        record(given_seed=1000 + k, seed=7919 * k % 1009, success=k % 3 == 0, run_id=run)
        for run in ("a", "b")
        for k in range(batches * batch)
    ]
    counted = [each for each in ran if each.given_seed < 1000 + episodes]
    chance.shuffle(ran)  # type: ignore[attr-defined]
    found = first_episodes(ran, episodes)
    assert sorted(each.given_seed for each in found) == sorted(each.given_seed for each in counted)
    (one, two) = split_evaluations(found)
    assert summarise(one).overall == summarise(two).overall
    assert summarise(one).overall.success.episodes == episodes


def test_what_must_not_be_mixed_or_compared_is_said() -> None:
    def said(*groups: list[EpisodeRecord]) -> str:
        return "\n".join(compare({str(k): group for k, group in enumerate(groups)}).warnings())

    plain = [record(seed=1), record(seed=2)]
    assert said(plain, plain) == ""
    assert "test and validation scenes are mixed" in said([*plain, record(seed=1_000_001)])
    assert "demonstrations are recorded in" in said([record(seed=2**24)])
    assert "more than one simulation version" in said([*plain, record(seed=3, simulation_version=1)])
    assert "simulation versions differ" in said(plain, [record(simulation_version=1)])
    newer = record(seed=3, versions={"torch": "2.12.0", "numpy": "2.0"})
    for groups in ([[*plain, newer]], [plain, [newer]]):
        assert said(*groups) == "measured with different versions installed: torch 2.11.0 and 2.12.0"
    assert "mechanism rules differ" in said(plain, [record(mechanism_rules="upstream")])
    assert "splits of scenes differ" in said(plain, [record(seed=1_000_001)])


def test_every_group_that_two_evaluations_share_has_a_difference_parted_at_the_same_values() -> None:
    one = [record(seed=k, knob_range=1.0 + k / 10, locked=k % 2 == 0) for k in range(4)]
    two = [record(seed=k, knob_range=2.0 + k / 10, locked=k % 2 == 0, success=False) for k in range(4)]
    comparison = compare({"one": one, "two": two})
    gaps = {each.group: each.success.difference for each in comparison.differences}
    assert gaps[ALL] == gaps[Group("hidden", "safe: locked")] == 1.0
    assert Group("hidden", "safe: knob_range < 1.65") not in gaps, "the second has none below"
    assert Group("hidden", "safe: knob_range < 1.65") in comparison.groups


def _of(object_id: str, episodes: int, **changes: Any) -> list[EpisodeRecord]:
    return [record(seed=k, object_id=object_id, **changes) for k in range(episodes)]


@pytest.mark.parametrize(
    ("one", "two", "without_difference"),
    [
        # Two failing policies; only one also played safes.
        (_of("safe_000", 30) + _of("bottle_000", 30, success=False), _of("bottle_000", 30, success=False), "all, seen"),
        # The same category, with unseen objects on one side alone.
        (_of("safe_000", 4), _of("safe_000", 4) + _of("safe_036", 4), "all, safe: direction +1, safe: "),
        # Equal shares, but more episodes: a comparison of rates.
        (_of("safe_000", 8) + _of("bottle_000", 8), _of("safe_000", 4) + _of("bottle_000", 4), ""),
    ],
)
def test_a_difference_needs_equal_shares_of_categories_and_objects(
    one: list[EpisodeRecord], two: list[EpisodeRecord], without_difference: str
) -> None:
    comparison = compare({"one": one, "two": two})
    parts = [group_records(records) for records in (one, two)]
    for each in comparison.differences:
        shares = [Counter((r.category, r.object_split) for r in part[each.group]) for part in parts]
        assert {(kind, count * shares[1].total()) for kind, count in shares[0].items()} == {
            (kind, count * shares[0].total()) for kind, count in shares[1].items()
        }
    assert any(each.success.difference == 0.0 for each in comparison.differences), "what is alike is compared"
    lines = [line for line in comparison.lines() if "no difference in" in line]
    assert [line.startswith(f"Warning: one - two, no difference in {without_difference}") for line in lines] == (
        [True] if without_difference else []
    )


def test_failed_tries_are_compared_in_the_scenes_that_both_opened() -> None:
    mine = [record(seed=1, wrong_turns=3), record(seed=2, wrong_turns=1), record(seed=3), record(seed=4, success=False)]
    expert = [record(seed=1, wrong_turns=1), record(seed=2), record(seed=4), record(seed=5)]
    comparison = compare({"mine": mine, "expert": expert})
    assert (comparison.extra_tries["expert"].value, comparison.extra_tries["expert"].count) == (1.5, 2)
    assert "mine - expert, failed tries in the 2 scenes that both opened: +1.50" in list(comparison.lines())
    assert comparison.to_json()["extra_tries"] == {"expert": {"mean": 1.5, "of": 2}}
    assert compare({"mine": mine, "other": [record(seed=9)]}).extra_tries["other"].value is None


@given(st.lists(st.tuples(any_record(), st.integers(0, 4), st.booleans()), min_size=1))
def test_extra_tries_in_the_same_opened_scenes_are_the_difference_of_the_means(
    drawn: list[tuple[EpisodeRecord, int, bool]],
) -> None:
    mine = without_repeats(replace(one, success=True) for one, _, _ in drawn)
    theirs = [
        replace(one, try_sequence=((0, 1, True),) * pulls + ((1, 1, False),) * moved)
        for one, (_, pulls, moved) in zip(mine, drawn, strict=False)
    ]
    comparison = compare({"mine": mine, "theirs": theirs})
    means = [one.overall.failed_tries for one in comparison.summaries.values()]
    assert comparison.extra_tries["theirs"].value == pytest.approx(means[0].value - means[1].value)  # type: ignore[union-attr, operator]
    (_, tries) = summarise([mine[0], replace(mine[0], repeat=1)]).again[0]
    assert tries == measure(mine[:1]).failed_tries
