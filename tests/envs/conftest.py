"""Helpers are importable by name, here and in processes that tests start."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

HERE = str(Path(__file__).parent)
if HERE not in sys.path:
    sys.path.insert(0, HERE)

from envs_helpers import OneSimulator  # noqa: E402  (found by the path above)


@pytest.fixture(scope="module")
def simulator() -> Iterator[OneSimulator]:
    """Shared by a module's tests; not the environment, which a test asks it for."""
    one = OneSimulator()
    yield one
    one.close()
