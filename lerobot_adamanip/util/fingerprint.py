"""What made an episode: hashes of the code that decides how it comes out, and the versions beside it.

A hash is taken of the code's syntax tree without docstrings, so comments, layout and documentation leave it as it is,
and any change of what is computed changes it.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import platform
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

VERSIONED = ("lerobot", "mani_skill", "sapien", "numpy", "torch", "fpsample", "scipy")
"""Distributions whose version may decide how an episode comes out."""
CORE_PARTS: Mapping[str, tuple[str, ...]] = {
    "contract": ("contract", "episode/rollout.py"),
    "mechanisms": ("mechanisms",),
    "objects": ("objects", "assets", "catalog.py"),
    "experts": ("experts",),
}
"""Part -> files and folders of this package."""
_LENGTH = 16


def code_hash(paths: Iterable[Path], but: Collection[Path] = ()) -> str:
    """Returns a short hash of Python files and folders, by content and relative name, whatever their order.

    Args:
        paths: files, and folders with all below them ...
        but: ... except these folders.
    """
    made = hashlib.sha256()
    for root in sorted(paths):
        for path in sorted(root.rglob("*.py")) if root.is_dir() else [root]:
            if any(path.is_relative_to(folder) for folder in but):
                continue
            name = path.relative_to(root.parent).as_posix()
            made.update(f"{name}\n{ast.dump(_without_docstrings(path.read_text(encoding='utf-8')))}\n".encode())
    return made.hexdigest()[:_LENGTH]


@functools.cache
def core_fingerprint() -> Mapping[str, str]:
    """Returns part -> hash of this package's code that decides episodes; see `CORE_PARTS`."""
    here = Path(__file__).parents[1]
    return {part: code_hash(here / name for name in names) for part, names in CORE_PARTS.items()}


@functools.cache
def versions() -> Mapping[str, str]:
    """Returns the installed versions of `VERSIONED`, and Python's."""
    found = {"python": platform.python_version()}
    for name in VERSIONED:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


@functools.cache
def cpu_model() -> str:
    """Returns this machine's kind of processor: renderers and arithmetic libraries choose their code by it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()


def combined(parts: Mapping[str, str]) -> str:
    """Returns one short hash of a fingerprint's parts: two episodes of one hash came from the same code."""
    text = "\n".join(f"{name}={parts[name]}" for name in sorted(parts))
    return hashlib.sha256(text.encode()).hexdigest()[:_LENGTH]


def _without_docstrings(source: str) -> ast.Module:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
    return tree


def _is_text(node: ast.AST) -> bool:
    """Whether a statement is a docstring, of a function, class, module or attribute."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
