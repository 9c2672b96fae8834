"""How many of our files and functions a reader has to follow: each way has a bound, and may only become shorter."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest
from uses import collected_episode, reported_episode, step_in_mid_episode
from ways import Way, traced

SIMULATED = pytest.mark.sim


WAYS: list[Any] = [
    # One use of the code, the most files, the most functions.
    pytest.param(step_in_mid_episode, 12, 76, marks=SIMULATED),
    pytest.param(collected_episode, 71, 493, marks=SIMULATED),
    pytest.param(reported_episode, 13, 83),
]


@pytest.mark.parametrize(("use", "files", "functions"), WAYS)
def test_a_way_is_no_longer_than_its_bound(use: Callable[[], Way], files: int, functions: int) -> None:
    # In a process of its own: what other tests have cached, or leave to be closed, is no part of the way.
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        way = process.submit(use).result()
    assert 0 < len(way.files) <= files, way
    assert len(way.functions) <= functions, way


def test_the_tracer_counts_our_functions_alone() -> None:
    from lerobot_adamanip.contract.rotations import rotation_about

    with traced() as way:
        [rotation_about((0.0, 0.0, 1.0), angle) for angle in np.linspace(0.0, 1.0, 3)]
    assert "lerobot_adamanip/contract/rotations.py:rotation_about" in way.functions
    assert way.files == {"lerobot_adamanip/contract/rotations.py"}
