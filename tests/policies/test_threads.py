"""Threads of a training: no more than the quota allows, and none that spins where others need the core."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from lerobot_policy_adamanip.common import threads
from lerobot_policy_adamanip.common.config import FusedAdamWConfig

SAME_WITHOUT_SPINNING = """
import hashlib, os, runpy, sys, torch
stop_spinning = runpy.run_path(sys.argv[1])["stop_spinning"]
torch.set_num_threads(2)
values = torch.rand(2048, 512, generator=torch.Generator().manual_seed(0))
def result():
    return hashlib.sha256((values @ values.T).sum(dim=0).numpy().tobytes()).hexdigest()
def tasks():
    return len(os.listdir("/proc/self/task"))
first, before = result(), tasks()
assert stop_spinning() and stop_spinning()
assert tasks() == before + len(os.sched_getaffinity(0)) + 1, "libgomp stops to spin above the number of CPUs"
assert result() == first
"""


@pytest.fixture
def step(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Takes a step of a fused optimizer's training per call; records the calls of `stop_spinning`."""
    calls: list[int] = []
    monkeypatch.setattr(threads, "stop_spinning", lambda: calls.append(1))
    for name in threads.WAITING:
        monkeypatch.delenv(name, raising=False)
    return calls


def one_step() -> None:
    weight = torch.nn.Parameter(torch.ones(3))
    optimizer = FusedAdamWConfig().build([weight])
    weight.square().sum().backward()
    optimizer.step()


def test_threads_spin_until_programs_wait_for_a_core(step: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    cpus = os.cpu_count() or 1
    for load, calls in ((float(cpus), 0), (cpus + 1.0, 1)):
        monkeypatch.setattr(os, "getloadavg", lambda load=load: (load, 0.0, 0.0))
        one_step()
        assert len(step) == calls
    monkeypatch.setenv("OMP_WAIT_POLICY", "active")  # a user's choice
    one_step()
    assert len(step) == 1


def test_without_spinning_results_are_the_same_bits() -> None:
    environment = {name: value for name, value in os.environ.items() if name not in threads.WAITING}
    subprocess.run(
        [sys.executable, "-c", SAME_WITHOUT_SPINNING, threads.__file__], check=True, env=environment, timeout=120
    )


@pytest.mark.parametrize(
    ("quotas", "cpus"),
    [
        ({}, math.inf), ({"": "max 100000"}, math.inf), ({"": "200000 100000"}, 2.0),
        ({"a": "max 100000", "a/b": "150000 100000"}, 1.5), ({"a": "50000 100000", "a/b": "400000 100000"}, 0.5),
    ],
    ids=str,
)  # fmt: skip
def test_the_narrowest_quota_of_the_control_groups_counts(tmp_path: Path, quotas: dict[str, str], cpus: float) -> None:
    (tmp_path / "group" / "a" / "b").mkdir(parents=True)
    for folder, text in quotas.items():
        (tmp_path / "group" / folder / "cpu.max").write_text(text)
    (tmp_path / "member").write_text("0::/a/b\n")
    assert threads.cpu_quota(tmp_path / "group", tmp_path / "member") == cpus
    assert threads.cpu_quota(tmp_path / "group", tmp_path / "missing") == math.inf


@pytest.mark.parametrize(
    ("quota", "variable", "left"), [(2.0, None, 2), (0.5, None, 1), (64.0, None, 4), (1.0, "4", 4)]
)
def test_a_training_uses_no_more_threads_than_the_quota(
    monkeypatch: pytest.MonkeyPatch, quota: float, variable: str | None, left: int
) -> None:
    threads_before = torch.get_num_threads()
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", variable)
    monkeypatch.setattr(threads, "cpu_quota", lambda: quota)
    torch.set_num_threads(4)
    try:
        FusedAdamWConfig().build([torch.nn.Parameter(torch.ones(1))])
        assert torch.get_num_threads() == left
    finally:
        torch.set_num_threads(threads_before)
