"""Progress where no terminal is: a line now and then, never a flood, and always the last one."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from lerobot_adamanip.cli.progress import MAX_INTERVAL_S, MIN_INTERVAL_S, ProgressLines, show_progress


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def lines(steps: int, seconds_each: float) -> list[str]:
    clock, stream = Clock(), io.StringIO()
    shown = ProgressLines({"work": "working"}, stream, clock)
    for number in range(steps + 1):
        shown("work", number, steps)
        shown("other", number, steps)
        clock.now += seconds_each
    return stream.getvalue().splitlines()


def test_slow_work_is_told_of_every_few_seconds() -> None:
    written = lines(1000, 1.0)
    assert 1000 / MAX_INTERVAL_S - 2 <= len(written) <= 1000 / MAX_INTERVAL_S + 25
    assert all(line.startswith("working: ") for line in written)
    assert "s left" in written[3]


def test_quick_work_floods_nothing_and_its_end_is_told() -> None:
    written = lines(1000, 0.001)
    assert len(written) == 2
    assert written[-1].startswith("working: 1000/1000 (100 %)")
    assert len(lines(1000, 0.1)) <= 100 / MIN_INTERVAL_S + 2


def test_without_a_terminal_it_is_lines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with open(tmp_path / "log", "w+") as log:
        monkeypatch.setattr(sys, "stderr", log)
        with show_progress({"work": "working"}) as progress:
            for _ in range(3):
                progress("work", 5, 5)  # a finished stage is written once
        log.seek(0)
        assert log.read() == "working: 5/5 (100 %) after 0 s\n"


def test_on_a_terminal_it_is_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with show_progress({"work": "working"}, every_stage=True) as progress:
        progress("work", 2, 5)
        progress("safe", 1, 5)
    assert "working" in terminal.getvalue()
    assert "2/5" in terminal.getvalue()
    assert "safe" in terminal.getvalue()


def test_the_time_left_is_that_of_this_run() -> None:
    clock, stream = Clock(), io.StringIO()
    shown = ProgressLines({"work": "working"}, stream, clock)
    shown("work", 90, 100)  # recorded by an earlier run
    clock.now = 50
    shown("work", 95, 100)
    assert stream.getvalue().splitlines()[-1] == "working: 95/100 (95 %) after 50 s, about 50 s left"


def test_the_start_of_the_work_counts() -> None:
    clock, stream = Clock(), io.StringIO()
    shown = ProgressLines({"work": "working", "end": "writing"}, stream, clock)
    clock.now = 20  # simulators start
    shown("work", 0, 4)
    clock.now = 30
    shown("end", 4, 4)
    assert stream.getvalue().splitlines() == ["working: 0/4 (0 %) after 20 s", "writing: 4/4 (100 %) after 0 s"]
