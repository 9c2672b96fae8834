"""Source of point clouds on this machine. Importing this module does not import the simulator."""

from __future__ import annotations

import functools
import importlib.util
import logging

from lerobot_adamanip.episode.options import CLOUD_SOURCES
from lerobot_adamanip.util.errors import require_choice

_logger = logging.getLogger(__name__)


def resolve_cloud_source(wanted: str) -> str:
    """Returns ``raycast`` or ``render``; falls back to ``render`` if embreex is not installed."""
    require_choice("source of clouds", wanted, CLOUD_SOURCES)
    if wanted == "raycast" and importlib.util.find_spec("embreex") is None:
        _tell_once("embreex is not installed, so clouds are rendered, some ten times slower: pip install embreex")
        return "render"
    return wanted


@functools.cache
def _tell_once(text: str) -> None:
    _logger.warning(text)
