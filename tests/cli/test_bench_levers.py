"""Levers of training: what the benchmark compares really are the two ways, and it leaves the fast one behind."""

from __future__ import annotations

import pytest

from lerobot_adamanip.cli.bench.levers import busy_cores, plain_gradients
from lerobot_adamanip.cli.bench.timing import compare_ms
from lerobot_policy_adamanip.common.encoders import PointNetEncoder


def test_two_ways_take_turns_and_the_warm_up_does_not_count() -> None:
    calls: list[str] = []
    compared = compare_ms(lambda: calls.append("plain"), lambda: calls.append("fast"), 2)
    assert calls == ["plain", "fast"] * 3
    assert set(compared) == {"plain_ms", "ms", "speedup"}


def test_the_plain_way_ends_with_its_block() -> None:
    def fail() -> None:
        with plain_gradients():
            assert not PointNetEncoder.winners_only
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert PointNetEncoder.winners_only


def test_work_keeps_a_core_busy() -> None:
    assert busy_cores(lambda: sum(range(300_000)), 20) > 0
