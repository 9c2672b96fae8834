"""Checks of this process's home folder and user name, which the end of a collection needs."""

from __future__ import annotations

import getpass
import os
from pathlib import Path

from lerobot_adamanip.util.errors import ConfigurationError


def require_account() -> None:
    """Raises `ConfigurationError` without a home folder or a user name, as in a container with a foreign user id.

    LeRobot and the Hub's client need a home folder when they are imported, and PyTorch names a cache folder by the
    user. All three fail with a traceback, and only when the recorded episodes become a dataset.
    """
    try:
        Path.home()
    except RuntimeError:
        raise ConfigurationError(
            "This process has no home folder, which LeRobot needs for its caches.",
            got=f"HOME is not set, and user id {os.getuid()} has no account",
            allowed="a folder that you can write to",
            hint='export HOME="$PWD" USER=me',
        ) from None
    try:
        getpass.getuser()
    except (OSError, KeyError):
        if os.environ.get("TORCHINDUCTOR_CACHE_DIR"):
            return
        raise ConfigurationError(
            "This process has no user name, which PyTorch needs for its cache.",
            got=f"USER is not set, and user id {os.getuid()} has no account",
            allowed="any name in USER, or a folder in TORCHINDUCTOR_CACHE_DIR",
            hint="export USER=me",
        ) from None
