"""A finished dataset of the fake environment."""

from __future__ import annotations

from pathlib import Path

import pytest
from demos_helpers import fakes, make_spec, patiently

from lerobot_adamanip.demos.collect import collect


@pytest.fixture(scope="session")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete dataset with late starts and attempts that failed. Not to be written to."""
    root = tmp_path_factory.mktemp("published") / "dataset"
    collect(root, make_spec(), fakes(), patiently())
    return root
