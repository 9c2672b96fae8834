"""Close several resources: one that fails must not leave the others open or hide an earlier error."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterable, Iterator

_logger = logging.getLogger(__name__)


def close_all(calls: Iterable[Callable[[], object]]) -> None:
    """Calls all functions, even if some raise. Then raises the first error and logs the others."""
    errors: list[BaseException] = []
    for call in calls:
        try:
            call()
        except BaseException as error:
            errors.append(error)
    for later in errors[1:]:
        _logger.warning("Closing failed as well: %s", later)
    if errors:
        raise errors[0]


@contextlib.contextmanager
def closing_on_error(close: Callable[[], object]) -> Iterator[None]:
    """Calls ``close`` if the block raises. The block's error is raised, and an error of ``close`` is logged."""
    try:
        yield
    except BaseException:
        try:
            close()
        except Exception as error:
            _logger.warning("Closing failed as well: %s", error)
        raise
