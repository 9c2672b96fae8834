"""Which rules change a category is what its mechanisms say."""

from __future__ import annotations

import pytest

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.mechanisms import DEFAULT_MECHANISM_RULES, MECHANISM_RULES, make_mechanism
from lerobot_adamanip.mechanisms.unchanged_rules import changed_categories


@pytest.mark.parametrize("rules", MECHANISM_RULES)
def test_changed_categories_are_those_with_another_mechanism(rules: str) -> None:
    objects = [make_object(f"{name}_000") for name in CATEGORIES]
    default = DEFAULT_MECHANISM_RULES
    changed = [
        each.category for each in objects if vars(make_mechanism(each, rules)) != vars(make_mechanism(each, default))
    ]
    assert set(changed_categories(rules)) == set(changed)
