"""Which rules change a category is what its mechanisms say."""

from __future__ import annotations

from typing import Any

import pytest

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.mechanisms import (
    DEFAULT_MECHANISM_RULES,
    MECHANISM_RULES,
    Mechanism,
    categories_with,
    make_mechanism,
)
from lerobot_adamanip.mechanisms.table import changed_categories


def told(mechanism: Mechanism[Any]) -> tuple[type, dict[str, Any]]:
    return type(mechanism), vars(mechanism)


@pytest.mark.parametrize("rules", MECHANISM_RULES)
def test_changed_categories_are_those_with_another_mechanism(rules: str) -> None:
    objects = [make_object(f"{name}_000") for name in categories_with(rules)]
    default = DEFAULT_MECHANISM_RULES
    changed = [
        each.category for each in objects if told(make_mechanism(each, rules)) != told(make_mechanism(each, default))
    ]
    assert set(changed_categories(rules)) == set(changed)
