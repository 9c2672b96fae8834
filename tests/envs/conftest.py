"""One simulator per module of tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from envs_helpers import OneSimulator


@pytest.fixture(scope="module")
def simulator() -> Iterator[OneSimulator]:
    """Shared by a module's tests; not the environment, which a test asks it for."""
    one = OneSimulator()
    yield one
    one.close()
