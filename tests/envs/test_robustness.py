"""Nonsense neither crashes nor explodes, in any category. The full run: ``scripts/check_robustness.py --seeds 100``."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest
from envs_helpers import ROOT, at_once_or_at_night

from lerobot_adamanip.contract.categories import CATEGORIES

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def script() -> Any:
    spec = importlib.util.spec_from_file_location("check_robustness", ROOT / "scripts" / "check_robustness.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@at_once_or_at_night("category", CATEGORIES, ("safe",))
def test_random_wild_and_malformed_actions_do_no_harm(script: Any, category: str) -> None:
    assert [each["wrong"] for each in script.check(category, [1, 2])] == [[], []]
