"""Fingerprint of a collection: the environment's, plus the code that turns its episodes into dataset rows."""

from __future__ import annotations

import functools

from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util.fingerprint import code_closure, code_hash

RECORDING = ("lerobot_adamanip.collection.record", "lerobot_adamanip.collection.assemble")
"""Entry modules for the code that writes rows."""


@functools.cache
def recording_hash() -> str:
    """Returns a hash of the code that records and assembles episodes."""
    return code_hash(code_closure(*RECORDING))


def collection_fingerprint(env: SimulatedEnvironment) -> dict[str, str]:
    """Returns part -> hash or name of everything that affects the rows of a dataset from this environment."""
    return {**env.fingerprint(), "recording": recording_hash()}
