"""Warnings about what was left out, each given once in a process."""

from __future__ import annotations

import functools
import logging

logger = logging.getLogger(__name__)


@functools.cache
def warn_once(text: str) -> None:
    """Logs a warning, the first time only: objects are loaded again and again."""
    logger.warning("%s", text)
