"""Random hands: no joint moves or tells its state without a try. The full run is ``scripts/check_tries.py``."""

from __future__ import annotations

import check_tries
import pytest
from check_common import check_scenes
from envs_helpers import at_once_or_at_night

from lerobot_adamanip.contract.categories import CATEGORIES

pytestmark = pytest.mark.sim


@at_once_or_at_night("category", CATEGORIES, ("lamp",))
def test_no_joint_moves_or_is_released_or_tells_without_a_try(category: str) -> None:
    scenes = 3 if category == "lamp" else 6
    results = check_scenes(category, range(scenes), check_tries.check)
    assert [result.wrong for result in results] == [[]] * len(results)
    assert sum(result.hands for result in results) >= 3 * scenes
    assert sum(sum(result.tries.values()) for result in results) > 0, "some hands try"
