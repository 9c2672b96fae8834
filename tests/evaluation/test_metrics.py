"""Groups, tries and repeats: laws, not values."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from records import record

from lerobot_adamanip.evaluation.comparison import compare
from lerobot_adamanip.evaluation.groups import ALL, Group, group_records, hidden_boundaries, worth_showing
from lerobot_adamanip.evaluation.metrics import (
    best_tries,
    count_tries,
    first_episodes,
    split_evaluations,
    summarise,
    tried_locked_first,
    warnings_of,
    without_repeats,
)
from lerobot_adamanip.evaluation.plots import cumulative_rates
from lerobot_adamanip.evaluation.record import EpisodeRecord

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
        first_part=draw(st.sampled_from(["handle", "knob"])),
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
    failures = summary.episodes - summary.overall.success.count
    assert sum(result.failures for result in summary.objects.values()) == failures
    assert (summary.overall.key_frames_of_successes is None) == (summary.overall.success.count == 0)
    assert next(iter(summary.groups)) == ALL


@given(RECORDS)
def test_each_hidden_value_parts_its_category(records: list[EpisodeRecord]) -> None:
    kept = without_repeats(records)
    groups = group_records(kept)
    for category in {each.category for each in kept}:
        mine = [each for each in kept if each.category == category]
        for name in mine[0].hidden_state:
            said = {"locked": ("locked", "unlocked")}.get(name, (name,))
            parts = [
                chosen
                for group, chosen in groups.items()
                if group.by == "hidden" and group.name.startswith(tuple(f"{category}: {each}" for each in said))
            ]
            assert sum(map(len, parts)) == len(mine), (category, name)


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
    boundaries = hidden_boundaries(records)
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
    twice = summarise([*records, *records])
    assert twice.episodes == summarise(records).episodes
    assert twice.overall.success == summarise(records).overall.success


def test_one_seed_on_two_objects_or_with_another_hidden_state_is_two_episodes() -> None:
    assert summarise([record(), record(object_id="safe_001"), record(locked=True)]).episodes == 3


@given(RECORDS)
def test_order_does_not_matter_without_repeats(records: list[EpisodeRecord]) -> None:
    kept = without_repeats(records)
    forward, backward = summarise(kept), summarise(kept[::-1])
    assert list(forward.groups) == list(backward.groups)
    assert {group: result.success for group, result in forward.groups.items()} == {
        group: result.success for group, result in backward.groups.items()
    }
    assert forward.objects == backward.objects


def test_two_evaluations_in_one_log_are_told_apart() -> None:
    log = [record(seed=1), record(seed=1, run_id="b"), record(seed=2), record(seed=2, run_id="b", success=False)]
    first, second = split_evaluations(log)
    assert [each.seed for each in first] == [each.seed for each in second] == [1, 2]
    assert summarise(first).overall.success.count == 2
    assert summarise(second).overall.success.count == 1
    assert len(split_evaluations([record(evaluation=k) for k in range(3)])) == 3


def test_trying_the_locked_door_first_needs_a_lock_the_handle_and_a_failed_pull() -> None:
    assert tried_locked_first(record(locked=True, blocked_pulls=1))
    assert not tried_locked_first(record(blocked_pulls=1))
    assert not tried_locked_first(record(locked=True, blocked_pulls=1, first_part="knob"))
    assert not tried_locked_first(record(locked=True))
    assert not tried_locked_first(record(locked=True, blocked_pulls=1, first_try_failed=False))


def test_the_best_strategy_wastes_nothing_and_each_further_try_one() -> None:
    # Of two locked safes, the best strategy turns one knob the wrong way first.
    lucky = record(seed=2, locked=True, blocked_pulls=1, key_moved=True)
    unlucky = record(seed=3, locked=True, blocked_pulls=1, key_moved=True, wrong_turns=1)
    best = count_tries([record(), lucky, unlucky])
    assert best is not None
    assert best.wasted == pytest.approx(0)
    for more in ({"locked": True, "blocked_pulls": 1}, {"key_moved": True}, {"wrong_turns": 1}):
        worse, plain = count_tries([record(**more), record()]), count_tries([record(), record()])
        assert worse is not None
        assert plain is not None
        assert worse.made - plain.made == pytest.approx(0.5)


@given(RECORDS)
def test_who_does_nothing_wastes_nothing_and_failures_change_no_number_of_tries(records: list[EpisodeRecord]) -> None:
    idle = record(seed=99, locked=True, success=False, key_frames=45, tries=0, first_part=None)
    assert count_tries([idle]) is None
    assert summarise([idle]).overall.tries is None
    assert count_tries([*records, idle]) == count_tries(records)


@pytest.mark.parametrize(
    ("hidden", "best"),
    [
        ({"locked": False}, 0.0), ({"locked": True}, 1.0), ({"locked": False, "direction": 1}, 0.0),
        ({"locked": True, "direction": 1}, 1.5), ({"direction": -1, "turn_range": 1.1}, 0.5), ({"mode": 2}, 1.0),
    ],
)  # fmt: skip
def test_knowing_nothing_costs_what_the_hidden_values_say(hidden: dict[str, object], best: float) -> None:
    assert best_tries(record(hidden_state=hidden)) == best


def test_a_direction_that_never_changes_costs_nothing() -> None:
    def cost(preset: str) -> float:
        return best_tries(record(object_id="pressure_cooker_000", mechanism_rules=preset))

    assert (cost("paper"), cost("upstream"), cost("hard")) == (0.0, 0.0, 0.5)


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
        return "\n".join(warnings_of({str(k): summarise(group) for k, group in enumerate(groups)}))

    plain = [record(seed=1), record(seed=2)]
    assert said(plain, plain) == ""
    assert "test and validation scenes are mixed" in said([*plain, record(seed=1_000_001)])
    assert "demonstrations are recorded in" in said([record(seed=2**24)])
    assert "more than one fingerprint" in said([*plain, record(seed=3, fingerprint="ffffffffffffffff")])
    assert "fingerprints differ" in said(plain, [record(fingerprint="ffffffffffffffff")])
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
