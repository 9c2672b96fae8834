"""What a row can learn from: interactions before it, and those whose outcome at it is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.adaafford.interactions import InteractionLabels, label_interactions
from lerobot_policy_adamanip.affordance.demonstrations import Demonstrations, read_demonstrations


@pytest.fixture
def demonstrations(adaptive_toy_root: Path) -> Demonstrations:
    return read_demonstrations(SimpleNamespace(root=adaptive_toy_root))


@pytest.fixture
def labels(demonstrations: Demonstrations) -> InteractionLabels:
    return label_interactions(demonstrations, 32, 32)


def test_what_an_expert_did_not_mean_is_history_without_a_result(demonstrations: Demonstrations) -> None:
    before = label_interactions(demonstrations, 32, 32)
    row = int(np.flatnonzero(demonstrations.meant & (demonstrations.tried >= 0) & ~demonstrations.failed)[0])
    meant = np.arange(len(demonstrations)) != row
    after = label_interactions(replace(demonstrations, meant=meant), 32, 32)
    number = next(each for each in range(len(before.moved)) if row_of(demonstrations, before, each) == row)
    assert before.tried[number]
    assert before.moved[number]
    assert not after.tried[number]
    assert not after.moved[number]
    assert number not in after.candidates
    assert (number in after.history) == (number in before.history)
    assert before.moved.sum() - after.moved.sum() == 1
    assert len(before.moved) - len(after.moved) == 1  # its way back


def row_of(demonstrations: Demonstrations, labels: InteractionLabels, number: int) -> int:
    """The row in which a real interaction was made."""
    same = (demonstrations.commands == labels.command[number]).all(1) & (
        demonstrations.poses == labels.before[number]
    ).all(1)
    (row,) = np.flatnonzero(same & ~demonstrations.final)
    return int(row)


def numbers(row: np.ndarray) -> list[int]:
    found = row[row >= 0].tolist()
    assert (row[len(found) :] == -1).all()
    return found


def test_before_a_row_are_the_motions_in_contact_before_it_oldest_first(
    demonstrations: Demonstrations, labels: InteractionLabels
) -> None:
    short = label_interactions(demonstrations, 2, 32)
    for rows in demonstrations.episodes():
        in_contact = [row for each in demonstrations.contacts(rows) for row in range(each.first, each.end)]
        for row in range(rows.start, rows.stop - 1):
            told = [row_of(demonstrations, labels, number) for number in numbers(labels.history[row])]
            assert told == [each for each in in_contact if each < row]
            assert numbers(short.history[row]) == numbers(labels.history[row])[-2:]  # the latest


def test_an_interaction_tells_what_came_of_it(demonstrations: Demonstrations, labels: InteractionLabels) -> None:
    for number in np.unique(labels.history[labels.history >= 0]):
        row = row_of(demonstrations, labels, number)
        np.testing.assert_array_equal(labels.after[number], demonstrations.poses[row + 1])
        assert labels.tried[number] == (demonstrations.tried[row] >= 0)
        assert labels.moved[number] == (demonstrations.tried[row] >= 0 and not demonstrations.failed[row])
        assert labels.opening[number] == 1


def test_known_at_a_row_is_what_was_tried_while_nothing_moved_before_or_after_it(
    demonstrations: Demonstrations, labels: InteractionLabels
) -> None:
    for rows in demonstrations.episodes():
        stretch = demonstrations.stretches(rows)
        tried = np.flatnonzero(demonstrations.tried[rows] >= 0)
        for row in range(rows.stop - rows.start - 1):
            known = [each for each in numbers(labels.candidates[rows.start + row]) if labels.tried[each]]
            found = sorted(row_of(demonstrations, labels, each) - rows.start for each in known)
            assert found == [each for each in tried.tolist() if stretch[each] == stretch[row]]


def test_the_way_back_is_no_success_where_something_has_moved(
    demonstrations: Demonstrations, labels: InteractionLabels
) -> None:
    for rows in demonstrations.episodes():
        moved = [row for row in range(rows.start, rows.stop - 1) if demonstrations.tried[row] >= 0]
        moved = [row for row in moved if not demonstrations.failed[row]]
        for row in range(rows.start, rows.stop - 1):
            back = [each for each in numbers(labels.candidates[row]) if not labels.tried[each]]
            before = [each for each in moved if each < row]
            assert len(back) == bool(before)
            for each in back:
                assert labels.moved[each] == 0
                np.testing.assert_array_equal(labels.before[each], demonstrations.poses[before[-1] + 1])
                np.testing.assert_array_equal(labels.command[each][:9], demonstrations.poses[before[-1]][:9])
                assert labels.command[each][9] == 0


def test_who_never_fails_teaches_no_adapting(toy_root: Path) -> None:
    with pytest.raises(ConfigurationError, match="expert adaptive"):
        label_interactions(read_demonstrations(SimpleNamespace(root=toy_root)), 8, 8)
