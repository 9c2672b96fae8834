"""The fingerprint of a collection: an environment's, and the code that makes a dataset's rows of its episodes."""

from __future__ import annotations

import functools

from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util.fingerprint import code_closure, code_hash

RECORDING = ("lerobot_adamanip.collection.record", "lerobot_adamanip.collection.assemble")
"""Modules that rows start from."""


@functools.cache
def recording_hash() -> str:
    """Returns a hash of the code that records and assembles episodes."""
    return code_hash(code_closure(*RECORDING))


def collection_fingerprint(env: SimulatedEnvironment) -> dict[str, str]:
    """Returns part -> hash or name of what decides the rows of a dataset that is collected in an environment."""
    return {**env.fingerprint(), "recording": recording_hash()}
