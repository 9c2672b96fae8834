"""Fingerprints: hashes of the code that affects results, and installed versions.

The code is the import closure of named modules. A hash covers the syntax tree without docstrings, so comments, layout
and documentation do not change it.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import importlib.metadata
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path

from lerobot_adamanip.util.import_graph import ImportGraph, our_import_graph

VERSIONED = ("lerobot", "mani_skill", "sapien", "numpy", "torch", "fpsample", "scipy")
"""Distributions whose version may affect episodes."""
DECIDES_NOTHING: Mapping[str, str] = {
    "lerobot_adamanip.util.errors": "texts of errors",
    "lerobot_adamanip.util.fingerprint": "tells what decides",
    "lerobot_adamanip.util.import_graph": "tells what decides",
    "lerobot_adamanip.util.jobs": "processes that do the work",
    "lerobot_adamanip.datasets.cards": "texts beside a dataset",
    "lerobot_adamanip.hub": "what is published",
    "lerobot_adamanip.lerobot_patches.durable_recording": "recordings of robots",
    "lerobot_adamanip.lerobot_patches.episode_signals": "recordings of robots",
    "lerobot_adamanip.lerobot_patches.ordered_depth": "recordings of robots",
    "lerobot_env_adamanip.fingerprint": "tells what decides",
}
"""Excluded module or package -> reason. There are no other exceptions."""
_LENGTH = 16


@functools.cache
def code_closure(*entries: str) -> frozenset[str]:
    """Returns this project's modules that affect the results of ``entries``, which are module names."""
    return our_import_graph().closure(entries, DECIDES_NOTHING)


def code_hash(modules: Iterable[str], graph: ImportGraph | None = None) -> str:
    """Returns a short hash of modules by name and content, independent of their order.

    Args:
        modules: dotted names.
        graph: import graph of their packages; by default this project's.
    """
    files, made = (graph or our_import_graph()).modules, hashlib.sha256()
    for module in sorted(modules):
        tree = _without_docstrings(files[module].read_text(encoding="utf-8"))
        made.update(f"{module}\n{ast.dump(tree)}\n".encode())
    return made.hexdigest()[:_LENGTH]


@functools.cache
def versions() -> Mapping[str, str]:
    """Returns the installed versions of Python and of `VERSIONED`."""
    found = {"python": platform.python_version()}
    for name in VERSIONED:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


@functools.cache
def cpu_model() -> str:
    """Returns this machine's CPU model, because renderers and arithmetic libraries select code by it."""
    with contextlib.suppress(OSError, IndexError):
        info = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        if name := info.split("\nmodel name", 1)[1].partition(":")[2].partition("\n")[0].strip():
            return name
    return platform.processor() or platform.machine()


def combined(parts: Mapping[str, str]) -> str:
    """Returns one short hash of all fingerprint parts; equal hashes mean equal code and versions."""
    text = "\n".join(f"{name}={parts[name]}" for name in sorted(parts))
    return hashlib.sha256(text.encode()).hexdigest()[:_LENGTH]


def _without_docstrings(source: str) -> ast.Module:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
    return tree


def _is_text(node: ast.AST) -> bool:
    """Returns whether a statement is a docstring of a function, class, module or attribute."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
