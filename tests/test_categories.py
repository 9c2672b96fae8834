"""The table of categories, and the documentation made from it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.benchmark.paper_rates import PAPER_CATEGORIES
from lerobot_adamanip.catalog import make_object, object_id
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.experts import EXPERTS, make_expert
from lerobot_adamanip.mechanisms import make_mechanism, rules_of

ROOT = Path(__file__).resolve().parents[1]


def test_the_papers_counts_add_up() -> None:
    assert set(PAPER_CATEGORIES) <= set(CATEGORIES)
    assert set(ROLES) == set(CATEGORIES), "external assets can be of each"
    assert sum(CATEGORIES[name].seen for name in PAPER_CATEGORIES) == 277


@pytest.mark.parametrize("name", CATEGORIES)
def test_a_category_has_objects_rules_and_experts_that_fit_each_other(name: str) -> None:
    obj = make_object(object_id(name, 0))
    assert (obj.category, obj.object_id) == (name, object_id(name, 0))
    parts = {part.name: part for part in obj.parts}
    for preset in rules_of(name):
        mechanism = make_mechanism(obj, preset)
        carried = {motion.joint for part in obj.parts for motion in part.motions}
        assert set(mechanism.joints) == carried
    import numpy as np

    first = next(make_expert(name, "adaptive", parts, generator=np.random.default_rng(0)))
    assert first.gripper == 1.0
    assert EXPERTS[name].sequence


def test_the_page_of_categories_is_what_the_code_says() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "make_category_table.py"), "--check"], check=False, timeout=240
    )
    assert done.returncode == 0, "run: python scripts/make_category_table.py"
