"""Names of objects: one id is one object, and seen and unseen ones do not mix."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_adamanip.catalog import (
    category_of,
    make_object,
    novel_objects,
    object_id,
    object_split,
    parse_object_id,
    parse_object_selection,
    seen_objects,
    unseen_objects,
)
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.errors import ConfigurationError

numbers = st.integers(0, 999_999)


@given(numbers)
@settings(max_examples=10, deadline=None)
def test_an_object_carries_the_id_it_was_made_by(number: int) -> None:
    name = object_id("safe", number)
    assert (make_object(name).object_id, make_object(name).category) == (name, "safe")


@pytest.mark.parametrize(
    "name",
    [
        "", "safe", "safe_", "safe_7", "safe_07", "safe_0007", "safe_1234567", "safe_-01", "safe_abc", "SAFE_001",
        " safe_001", "safe_001 ", "safe_001\n", "safe-001",
        "safe_n1", "safe_n01", "safe_nn001", "safe_٠٠١", "fridge_001", "safe_001/../safe_002",
    ],
)  # fmt: skip
def test_what_is_no_id_is_refused(name: str) -> None:
    for use in (parse_object_id, make_object):
        with pytest.raises(ConfigurationError) as caught:
            use(name)
        assert repr(name) in str(caught.value)


@given(st.text(max_size=20))
@settings(max_examples=200, deadline=None)
def test_any_text_is_an_id_or_refused_and_no_object_has_two(name: str) -> None:
    try:
        category, number = parse_object_id(name)
    except ConfigurationError:
        return
    assert object_id(category, number, novel=object_split(name) == "novel") == name


@given(st.sampled_from(tuple(CATEGORIES)), numbers)
@settings(max_examples=60, deadline=None)
def test_a_novel_id_is_another_object_s_of_the_same_category(category: str, number: int) -> None:
    name = object_id(category, number, novel=True)
    assert name != object_id(category, number)
    assert parse_object_id(name) == (category, number)
    assert (object_split(name), category_of(name)) == ("novel", category)


def test_an_id_tells_its_split() -> None:
    splits = {"seen": seen_objects, "unseen": unseen_objects, "novel": novel_objects}
    for category in CATEGORIES:
        for split, listed in splits.items():
            assert {object_split(name) for name in listed(category)} == {split}
            assert parse_object_selection(category, split) == listed(category)
    assert len(novel_objects("safe")) == 20
    assert object_split("safe:sa1") is None
    with pytest.raises(ConfigurationError):
        object_split("safe_n1")


def test_seen_objects_are_the_paper_s_count_and_no_unseen_one_is_among_them() -> None:
    seen, unseen = seen_objects("safe"), unseen_objects("safe", 500)
    assert len(set(seen)) == 36
    assert len(set(unseen)) == 500
    assert not set(seen) & set(unseen)
    assert unseen_objects("safe") == unseen[:20]


@pytest.mark.parametrize(
    "call", [seen_objects, unseen_objects, lambda c: object_id(c, 1), lambda c: parse_object_selection(c, "seen")]
)
def test_an_unknown_category_is_refused_with_those_there_are(call: object) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(CATEGORIES))):
        call("fridge")  # type: ignore[operator]


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        ("seen", seen_objects("safe")), ("unseen", unseen_objects("safe")), ("0:2", ("safe_000", "safe_001")),
        ("unseen_test", unseen_objects("safe", 40)[20:]), ("novel_test", novel_objects("safe", 40)[20:]),
        ("35:37", ("safe_035", "safe_036")), ("safe_004", ("safe_004",)),
        (" safe_007, safe_003,", ("safe_007", "safe_003")), ("999:1001", ("safe_999", "safe_1000")),
        ("n2:n4", ("safe_n002", "safe_n003")), ("safe_n001,safe_001", ("safe_n001", "safe_001")),
    ],
)  # fmt: skip
def test_a_selection_names_objects_in_the_order_it_says(selection: str, expected: tuple[str, ...]) -> None:
    assert parse_object_selection("safe", selection) == expected


@pytest.mark.parametrize(
    "selection",
    [
        "", ",", "3:3", "4:2", "0-4", ":4", "2:", "all", "safe_000,fridge_001", "safe_000;safe_001", "0:4,7", "n0:4",
        "0:n4",
    ],
)  # fmt: skip
def test_a_selection_of_nothing_or_of_no_objects_is_refused(selection: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_object_selection("safe", selection)
    assert all(word in str(caught.value) for word in ("got:", "allowed:", "try:"))
