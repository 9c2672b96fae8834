"""Collections of a fake environment; its factories are importable by name in spawned workers too."""

from __future__ import annotations

from pathlib import Path

import pytest
from demos_helpers import fakes, make_spec, patiently

from lerobot_adamanip.collection.collect import collect


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete dataset, recorded by one worker without interruption. Not to be written to."""
    root = tmp_path_factory.mktemp("finished") / "dataset"
    collect(root, make_spec(), fakes(), patiently())
    return root


@pytest.fixture(scope="session")
def unpictured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete dataset without pictures. Not to be written to."""
    root = tmp_path_factory.mktemp("unpictured") / "dataset"
    collect(root, make_spec(observe_images=False), fakes(), patiently())
    return root
