"""What has to be equal on every machine of a collection."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field

from lerobot_adamanip.util.errors import ConfigurationError

EQUAL = ("lerobot_env_adamanip", "lerobot", "mani_skill", "sapien", "numpy", "torch", "embreex", "fpsample", "scipy")
"""Distributions whose versions must be the driver's on every node: they may decide how an episode comes out."""
_ABSENT = "not installed"


@dataclass(frozen=True)
class NodeFacts:
    """What a machine says of itself.

    Attributes:
        node: its id in the cluster.
        host: its name.
        versions: of `EQUAL`.
    """

    node: str
    host: str
    versions: Mapping[str, str] = field(default_factory=dict)


def node_facts(node: str) -> NodeFacts:
    """Returns what this machine has."""
    return NodeFacts(node, platform.node(), {name: _version(name) for name in EQUAL})


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return _ABSENT


def require_equal_versions(driver: NodeFacts, other: NodeFacts) -> None:
    """Raises `ConfigurationError` naming each package whose version differs from the driver's."""
    if different := [name for name in EQUAL if driver.versions.get(name) != other.versions.get(name)]:
        raise ConfigurationError(
            f"A node of the cluster has other versions: {', '.join(different)}.",
            got=f"{other.host}: " + "; ".join(f"{name} {other.versions.get(name)}" for name in different),
            allowed="; ".join(f"{name} {driver.versions.get(name)}" for name in different) + ", as here",
            hint="install the same packages on every node (pip install -c constraints.txt), then start it again",
        )
