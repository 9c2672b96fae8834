"""The fingerprint of simulated episodes: the core's parts and the simulator's code. No simulator is started."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from pathlib import Path

from lerobot_adamanip.util.fingerprint import code_hash, combined, core_fingerprint


@functools.cache
def code_fingerprint() -> Mapping[str, str]:
    """Returns part -> hash of all code that decides how a simulated episode comes out."""
    here = Path(__file__).parent
    # The twin of a robot drives scenes in ways of its own; no simulated episode passes through it.
    simulator = code_hash([here / "sim", here / "keyframe_env.py"], but=[here / "sim" / "twin"])
    return {**core_fingerprint(), "simulator": simulator}


def present_fingerprint() -> str:
    """Returns one hash of `code_fingerprint`: what results of experts carry, the same on every machine."""
    return combined(code_fingerprint())


def environment_fingerprint() -> str:
    """Returns one hash of what decides how a policy's episode comes out: all of `code_fingerprint` but the experts."""
    return combined({part: made for part, made in code_fingerprint().items() if part != "experts"})


def present_fingerprints() -> frozenset[str]:
    """Returns what results of the present code carry, those of experts and those of policies."""
    return frozenset((present_fingerprint(), environment_fingerprint()))
