"""A finished dataset of the fake environment, and the check of an error's message, as in ``tests/demos``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from demos_helpers import fakes, make_spec, patiently

from lerobot_adamanip.demos.collect import collect
from lerobot_adamanip.errors import AdaManipError


@pytest.fixture(scope="session")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete dataset with late starts and attempts that failed. Not to be written to."""
    root = tmp_path_factory.mktemp("published") / "dataset"
    collect(root, make_spec(), fakes(), patiently())
    return root


@pytest.fixture
def refuses() -> Callable[[type[AdaManipError], Callable[[], Any]], str]:
    """Calls something that must raise; returns the message, which has to say all four things."""

    def check(kind: type[AdaManipError], call: Callable[[], Any]) -> str:
        with pytest.raises(kind) as caught:
            call()
        message = str(caught.value)
        assert all(word in message for word in ("got:", "allowed:", "try:"))
        return message

    return check
