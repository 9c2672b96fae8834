"""What the checks of this folder share: what a result says of itself, progress in words, options of a kind."""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lerobot_adamanip.fingerprint import versions
from lerobot_env_adamanip.fingerprint import present_fingerprint

ROOT = Path(__file__).resolve().parents[1]
EVERY = 15.0
"""Seconds between lines of progress."""


def header() -> dict[str, Any]:
    """What a result has to say of itself: command, commit where there is one, code and versions."""
    asked = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False)
    return {
        "command": shlex.join(["python", *sys.argv]),
        "commit": asked.stdout.strip() or None,
        "fingerprint": present_fingerprint(),
        "versions": dict(versions()),
    }


def count(text: str) -> int:
    """Parses a whole number from 1 up."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return value


def list_of(allowed: tuple[str, ...] | None) -> Callable[[str], tuple[str, ...]]:
    """Returns a parser of names out of ``allowed``, any if None, separated by commas."""

    def parse(text: str) -> tuple[str, ...]:
        chosen = tuple(dict.fromkeys(each.strip() for each in text.split(",")))
        if allowed is not None and (unknown := [each for each in chosen if each not in allowed]):
            raise argparse.ArgumentTypeError(f"{', '.join(unknown)} is none of {', '.join(allowed)}")
        return chosen

    return parse


class Progress:
    """A line now and then on standard error, with or without a terminal: episodes ``done`` of ``total``."""

    def __init__(self, done: int, total: int) -> None:
        self.done, self.total, self.start, self._said = done, total, time.monotonic(), -EVERY
        self._first = done

    def tell(self, finished: int) -> None:
        """Counts so many more episodes."""
        self.done += finished
        elapsed = time.monotonic() - self.start
        if elapsed - self._said >= EVERY or self.done == self.total:
            self._said = elapsed
            left = elapsed / (self.done - self._first) * (self.total - self.done)
            sys.stderr.write(f"{self.done}/{self.total} episodes, {elapsed:.0f} s, about {left:.0f} s left\n")
            sys.stderr.flush()
