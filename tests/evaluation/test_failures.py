"""How far episodes that failed had come."""

from __future__ import annotations

import pytest
from records import record

from lerobot_adamanip.evaluation.failures import AJAR, IN_VAIN, KEY_MOVED, NO_TRY, count_failures, failure_cause
from lerobot_adamanip.evaluation.metrics import summarise
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.evaluation.result_rows import rows_of_records
from lerobot_adamanip.evaluation.results import policy_result
from lerobot_adamanip.evaluation.tables import result_table

PULL = (0, 1, True)


def failed(seed: int, door: float = 0.0, **changes: object) -> EpisodeRecord:
    return record(
        seed=seed,
        given_seed=seed,
        success=False,
        joints={"door": door, "knob": 0.0},
        **changes,  # type: ignore[arg-type]
    )


EPISODES = [
    failed(1, try_sequence=(), tries=0, first_part=None, first_try_failed=False),
    failed(2, try_sequence=(PULL,), tries=1, blocked_pulls=1, key_moved=False),
    failed(3, try_sequence=(PULL,), tries=1, blocked_pulls=1, key_moved=True),
    failed(4, 0.2, try_sequence=(PULL,), tries=1, blocked_pulls=1, key_moved=True),
    failed(5, -0.2, try_sequence=(PULL,), tries=1, blocked_pulls=1, key_moved=False),
    record(seed=6, given_seed=6, success=True),
]


@pytest.mark.parametrize(
    ("episode", "cause"), list(zip(EPISODES, (NO_TRY, IN_VAIN, KEY_MOVED, AJAR, AJAR, None), strict=True))
)
def test_a_failure_is_told_by_how_far_it_came(episode: EpisodeRecord, cause: str | None) -> None:
    assert failure_cause(episode) == cause


def test_causes_are_counted_and_sum_to_the_failures() -> None:
    found = {NO_TRY: 1, IN_VAIN: 1, KEY_MOVED: 1, AJAR: 2}
    assert count_failures(EPISODES) == found
    assert summarise(EPISODES).failures == found


def test_the_page_tells_them_and_the_brief_table_does_not() -> None:
    result = policy_result(rows_of_records(EPISODES, "default"), EPISODES, title="t", command="c")
    assert "no try 1, tried in vain 1, key moved 1, ajar 2" in result_table(result)
    assert "no try" not in result_table(result, brief=True)
