"""The fingerprint of simulated episodes: hashes of the code that decides them. No simulator is started."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from lerobot_adamanip.evaluation.provenance import equivalent_fingerprints
from lerobot_adamanip.util.fingerprint import code_closure, code_hash, combined
from lerobot_adamanip.util.import_graph import is_within

ENVIRONMENT = ("lerobot_env_adamanip.keyframe_env", "lerobot_env_adamanip.sim.tasks")
"""Modules that every episode starts from."""
EXPERTS = ("lerobot_adamanip.experts", "lerobot_adamanip.episode.rollout")
"""Modules that an expert's episode starts from besides."""
PARTS: Mapping[str, tuple[str, ...]] = {
    "mechanisms": ("lerobot_adamanip.mechanisms",),
    "objects": ("lerobot_adamanip.objects", "lerobot_adamanip.assets", "lerobot_adamanip.catalog"),
    "simulator": ("lerobot_env_adamanip",),
}
"""Part of the environment's fingerprint -> packages it is about; the part ``contract`` has all others."""


@functools.cache
def code_fingerprint() -> Mapping[str, str]:
    """Returns part -> hash of all code that decides how a simulated episode comes out, an expert's too."""
    environment = code_closure(*ENVIRONMENT)
    parts = {
        name: frozenset(each for each in environment if is_within(each, packages)) for name, packages in PARTS.items()
    }
    parts["contract"] = environment.difference(*parts.values())
    parts["experts"] = code_closure(*EXPERTS) - environment
    return {name: code_hash(modules) for name, modules in parts.items()}


def present_fingerprint() -> str:
    """Returns one hash of `code_fingerprint`: what results of experts carry, the same on every machine."""
    return combined(code_fingerprint())


def environment_fingerprint() -> str:
    """Returns one hash of what decides how a policy's episode comes out: all of `code_fingerprint` but the experts."""
    return combined({part: made for part, made in code_fingerprint().items() if part != "experts"})


def present_fingerprints() -> frozenset[str]:
    """Returns what results of the present code carry, of experts and of policies, and what was shown to equal it."""
    return equivalent_fingerprints({present_fingerprint(), environment_fingerprint()})
