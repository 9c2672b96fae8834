"""What tries that failed were tried on."""

from __future__ import annotations

import pytest
from records import record

from lerobot_adamanip.evaluation.failed_tries import KEY_HELD, NO_FURTHER, PART_HELD, count_in_vain, failed_at
from lerobot_adamanip.evaluation.record import TryMade
from lerobot_adamanip.evaluation.result_rows import rows_of_records
from lerobot_adamanip.evaluation.results import policy_result
from lerobot_adamanip.evaluation.tables import result_table

PULL, PULLED = (0, 1, True), (0, 1, False)
TURN, TURNED, BACK = (1, 1, True), (1, 1, False), (1, -1, True)


@pytest.mark.parametrize(
    ("sequence", "found"),
    [
        ((), []),
        ((TURNED, PULLED), []),
        ((PULL, TURN, BACK), [PART_HELD, KEY_HELD, KEY_HELD]),
        ((TURN, BACK, TURNED, TURN), [KEY_HELD, KEY_HELD, NO_FURTHER]),
        ((TURNED, BACK, PULL), [KEY_HELD, PART_HELD]),
        ((PULLED, PULL, TURNED, TURN), [NO_FURTHER, NO_FURTHER]),
    ],
)
def test_what_failed_is_told_by_the_joint_and_by_whether_it_had_gone_that_way(
    sequence: tuple[TryMade, ...], found: list[str]
) -> None:
    assert failed_at(record(try_sequence=sequence)) == found


def test_tries_of_the_successes_are_counted_and_told_per_success() -> None:
    episodes = [
        record(seed=1, given_seed=1, success=True, try_sequence=(PULL, TURN, TURNED, PULLED)),
        record(seed=2, given_seed=2, success=True, try_sequence=(PULL, TURNED, PULLED)),
        record(seed=3, given_seed=3, success=False, try_sequence=(PULL, TURN, BACK)),
    ]
    assert count_in_vain(episodes) == {PART_HELD: 2, KEY_HELD: 1}
    result = policy_result(rows_of_records(episodes, "default"), episodes, title="t", command="c")
    assert "| part held 1.00, key held 0.50 |" in result_table(result)
    assert "part held" not in result_table(result, brief=True)
