"""The check of tries: every hidden state is compared, until a joint is tried; on frames that nobody simulates."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import check_tries
import numpy as np
import pytest
from check_hidden_state import VARIANTS

TASK = SimpleNamespace(category="lamp")
FRAMES, UNTRIED = 5, 3


@pytest.mark.parametrize("variant", range(len(VARIANTS["lamp"])))
@pytest.mark.parametrize("differs", range(FRAMES))
def test_a_difference_under_any_hidden_state_counts_before_a_try_only(
    variant: int, differs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def play(task: Any, seed: int, hidden: dict[str, Any], result: check_tries.Result) -> tuple[list[Any], int]:
        frames = [{"state": np.zeros(2)} for _ in range(FRAMES)]
        frames[differs]["state"][0] = hidden == VARIANTS["lamp"][variant]
        result.hands += check_tries.HANDS
        return frames, UNTRIED

    monkeypatch.setattr(check_tries, "play", play)
    result = check_tries.check(TASK, 800)
    assert bool(result.wrong) == (differs < UNTRIED)
    assert result.hands == check_tries.HANDS
