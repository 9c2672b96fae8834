"""Filter of LeRobot's warning of a slow loop, which means nothing where time passes by steps."""

from __future__ import annotations

import logging

SLOW_LOOP = ("Record loop is running slower", "Control loop is running slower")
"""Start of the warning in LeRobot 0.6.1, and in later ones."""


class SlowLoopFilter(logging.Filter):
    """Drops the warning in the root logger's handlers, from `install` to `remove`."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Returns whether a record is written."""
        return not str(record.msg).startswith(SLOW_LOOP)

    def install(self) -> None:
        """Idempotent."""
        for handler in logging.getLogger().handlers:
            handler.addFilter(self)

    def remove(self) -> None:
        """Idempotent."""
        for handler in logging.getLogger().handlers:
            handler.removeFilter(self)
