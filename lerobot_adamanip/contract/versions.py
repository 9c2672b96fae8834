"""Versions that decide whether two results can be compared: of episodes, of training data, of installed packages.

`SIMULATION_VERSION` and `DATA_VERSION` are raised by hand, in the commit that changes behaviour. ``tests/golden`` holds
values that both versions decide; its tests fail if a value changes and the version does not. Moving or renaming code
changes neither.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.metadata
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path

SIMULATION_VERSION = 3
"""Version of episodes: objects, mechanisms, scenes, physics, observations, tries, experts, and how metrics count them.

1: release 0.2. 2: development from 0.2 to 0.3. 3: version 0.3.
"""
DATA_VERSION = 3
"""Version of training data: stored rows, their labels, training batches, and the losses of this project's policies.

It starts at 3, like `SIMULATION_VERSION`, so that 1 and 2 mean the same code for both. Later the two may differ.
"""
SIMULATION, DATA = "simulation", "data"
"""Names of the two versions in `software_versions`."""
PACKAGES = ("lerobot", "mani_skill", "sapien", "gymnasium", "torch", "numpy", "scipy", "fpsample", "diffusers")
"""Distributions whose version may change an episode or a training."""


@functools.cache
def installed_versions() -> Mapping[str, str]:
    """Returns the versions of Python and of the installed ones of `PACKAGES`, by name."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def software_versions() -> dict[str, str]:
    """Returns `SIMULATION_VERSION`, `DATA_VERSION` and `installed_versions`, by name."""
    return {SIMULATION: str(SIMULATION_VERSION), DATA: str(DATA_VERSION), **installed_versions()}


@functools.cache
def cpu_model() -> str:
    """Returns this machine's CPU model, because renderers and arithmetic libraries select code by it."""
    with contextlib.suppress(OSError, IndexError):
        info = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        if name := info.split("\nmodel name", 1)[1].partition(":")[2].partition("\n")[0].strip():
            return name
    return platform.processor() or platform.machine()


def earlier_version(measured: Iterable[int]) -> str:
    """Returns a sentence that names the simulation versions ``measured``; empty if all are the present version."""
    versions = sorted(set(measured))
    if set(versions) <= {SIMULATION_VERSION}:
        return ""
    names = f"version{'s' if len(versions) > 1 else ''} {' and '.join(map(str, versions))}"
    return f"Measured with simulation {names}; the present one is {SIMULATION_VERSION}."


def joined_versions(several: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Returns name -> version over several mappings; different versions of a name are joined by ``and``."""
    versions: dict[str, set[str]] = {}
    for each in several:
        for name, version in each.items():
            versions.setdefault(name, set()).update(version.split(" and "))
    return {name: " and ".join(sorted(values)) for name, values in versions.items()}


def mixed_versions(several: Iterable[Mapping[str, str]]) -> str:
    """Returns the versions that differ: ``torch 2.10.0 and 2.11.0``; empty if none do.

    A name that one mapping lacks does not differ: its version is unknown there.
    """
    joined = joined_versions(several)
    return ", ".join(f"{name} {versions}" for name, versions in joined.items() if " and " in versions)
