"""Nonsense neither crashes nor explodes, in any category. The full run: ``scripts/check_robustness.py --seeds 100``."""

from __future__ import annotations

import check_robustness
import pytest
from envs_helpers import at_once_or_at_night

from lerobot_adamanip.contract.categories import CATEGORIES

pytestmark = pytest.mark.sim


@at_once_or_at_night("category", CATEGORIES, ("safe",))
def test_random_wild_and_malformed_actions_do_no_harm(category: str) -> None:
    assert [each["wrong"] for each in check_robustness.check(category, [1, 2])] == [[], []]
