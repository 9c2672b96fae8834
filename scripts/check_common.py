"""What the checks of this folder share: what a result says of itself, progress in words, options of a kind."""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lerobot_adamanip.util.errors import AdaManipError
from lerobot_adamanip.util.fingerprint import versions
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


def document_command(description: str | None, wanted: Callable[[], Mapping[Path, str]]) -> int:
    """Writes documents that are made of results, or with ``--check`` says which is not what it would be; exit status.

    Args:
        description: of the command line.
        wanted: makes document -> text.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a document would change")
    options = parser.parse_args()
    try:
        texts = wanted()
    except AdaManipError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    stale = [path for path, text in texts.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    for path in stale:
        if not options.check:
            path.write_text(texts[path], encoding="utf-8")
        sys.stdout.write(f"{'stale' if options.check else 'written'}: {path.relative_to(ROOT)}\n")
    return 1 if options.check and stale else 0


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
