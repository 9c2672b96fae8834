"""Fingerprint of simulated episodes: hashes of the code that affects them. Starts no simulator."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from lerobot_adamanip.evaluation.provenance import equivalent_fingerprints
from lerobot_adamanip.util.fingerprint import code_closure, code_hash, combined
from lerobot_adamanip.util.import_graph import is_within

ENVIRONMENT = ("lerobot_env_adamanip.keyframe_env", "lerobot_env_adamanip.sim.tasks")
"""Entry modules of every episode."""
EXPERTS = ("lerobot_adamanip.experts", "lerobot_adamanip.episode.rollout")
"""Additional entry modules of an expert's episode."""
PARTS: Mapping[str, tuple[str, ...]] = {
    "mechanisms": ("lerobot_adamanip.mechanisms",),
    "objects": ("lerobot_adamanip.objects", "lerobot_adamanip.assets", "lerobot_adamanip.catalog"),
    "simulator": ("lerobot_env_adamanip",),
}
"""Part of the environment's fingerprint -> its packages; the part ``contract`` has all others."""


@functools.cache
def code_fingerprint() -> Mapping[str, str]:
    """Returns part -> hash of all code that affects a simulated episode, including an expert's."""
    environment = code_closure(*ENVIRONMENT)
    parts = {
        name: frozenset(each for each in environment if is_within(each, packages)) for name, packages in PARTS.items()
    }
    parts["contract"] = environment.difference(*parts.values())
    parts["experts"] = code_closure(*EXPERTS) - environment
    return {name: code_hash(modules) for name, modules in parts.items()}


def present_fingerprint() -> str:
    """Returns one hash of `code_fingerprint`, for results of experts; equal on every machine."""
    return combined(code_fingerprint())


def environment_fingerprint() -> str:
    """Returns one hash of `code_fingerprint` without the experts, for results of policies."""
    return combined({part: made for part, made in code_fingerprint().items() if part != "experts"})


def present_fingerprints() -> frozenset[str]:
    """Returns the fingerprints of the present code, for experts and policies, and equivalent older ones."""
    return equivalent_fingerprints({present_fingerprint(), environment_fingerprint()})
