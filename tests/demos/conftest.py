"""Collections of a fake environment; its factories are importable by name in spawned workers too."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from demos_helpers import ATTEMPTS, OPTIONS

from lerobot_adamanip.demos.collect import collect
from lerobot_adamanip.demos.collection import CollectionSpec
from lerobot_adamanip.errors import AdaManipError


@pytest.fixture(scope="session")
def options() -> Callable[..., CollectionSpec]:
    """Builds options of a small fake collection, with changes."""
    return lambda **changes: CollectionSpec(**{**OPTIONS, **changes})


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, options: Callable[..., CollectionSpec]) -> Path:
    """A complete dataset, recorded by one worker without interruption. Not to be written to."""
    root = tmp_path_factory.mktemp("finished") / "dataset"
    collect(root, options(), max_attempts=ATTEMPTS)
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
