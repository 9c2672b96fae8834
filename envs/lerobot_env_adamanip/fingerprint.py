"""The fingerprint of simulated episodes: the core's parts and the simulator's code. No simulator is started."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path

from lerobot_adamanip.fingerprint import code_hash, combined, core_fingerprint


@functools.cache
def code_fingerprint() -> Mapping[str, str]:
    """Returns part -> hash of all code that decides how a simulated episode comes out."""
    here = Path(__file__).parent
    return {**core_fingerprint(), "simulator": code_hash([here / "sim", here / "keyframe_env.py"])}


def present_fingerprint() -> str:
    """Returns one hash of `code_fingerprint`: what logs and results carry, the same on every machine."""
    return combined(code_fingerprint())
