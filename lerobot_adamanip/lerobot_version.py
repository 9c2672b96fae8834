"""Whether LeRobot is as it was when something that builds on its private parts was written and tested.

Who replaces or builds on such parts names them, and a table of LeRobot's versions with the hash of their source.
"""

from __future__ import annotations

import hashlib
import inspect
import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any

_warned: set[tuple[str, str]] = set()


def source_hash(*parts: Any) -> str:
    """Returns a short hash of the source of modules, classes or functions, one after the other."""
    return hashlib.sha256("".join(map(inspect.getsource, parts)).encode()).hexdigest()[:16]


def is_tested(tested: Mapping[str, str], parts: Callable[[], Iterable[Any]]) -> bool:
    """Whether this LeRobot's version, and the source of the parts, are those that were tested.

    Args:
        tested: version -> `source_hash` of the parts.
        parts: imports and returns them; where it cannot, they are others.
    """
    try:
        import lerobot

        return tested.get(str(lerobot.__version__)) == source_hash(*parts())
    except (ImportError, AttributeError, OSError, TypeError):
        return False


def warn_untested(log: logging.Logger, tested: Iterable[str], consequence: str) -> None:
    """Warns, once for each logger, that LeRobot is none of the versions that were tested, and of what follows."""
    import lerobot

    version = str(getattr(lerobot, "__version__", "?"))
    if (log.name, version) not in _warned:
        _warned.add((log.name, version))
        log.warning(
            "LeRobot %s is not what lerobot_env_adamanip was tested with (%s): %s.",
            version,
            ", ".join(tested),
            consequence,
        )
