"""What a Hub holds: repositories of commits, branches and tags, as its answers tell of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

LFS_SUFFIXES = (".parquet", ".mp4", ".safetensors", ".png")


class ProblemError(Exception):
    """An answer that is no success."""

    def __init__(self, status: int, message: str, code: str | None = None, **content: Any) -> None:
        super().__init__(message)
        self.status, self.code, self.content = status, code, {"error": message, **content}


def git_oid(content: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()


def is_lfs(path: str) -> bool:
    return path.endswith(LFS_SUFFIXES)


@dataclass
class Repository:
    private: bool
    commits: dict[str, dict[str, bytes]] = field(default_factory=dict)
    branches: dict[str, str] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)

    def commit(self, branch: str, files: dict[str, bytes]) -> str:
        listing = json.dumps([len(self.commits), *((path, git_oid(content)) for path, content in files.items())])
        sha = hashlib.sha1(listing.encode()).hexdigest()
        self.commits[sha], self.branches[branch] = files, sha
        return sha

    def resolve(self, revision: str) -> str:
        found = self.branches.get(revision) or self.tags.get(revision)
        if found is None and revision in self.commits:
            found = revision
        if found is None:
            raise ProblemError(404, f"no revision {revision}", "RevisionNotFound")
        return found


def entries(files: dict[str, bytes], prefix: str, recursive: bool) -> Iterator[dict[str, Any]]:
    """Folders are listed too: what streams looks for its files folder by folder."""
    folders = set()
    for path, content in sorted(files.items()):
        inner = path.removeprefix(prefix).split("/") if path.startswith(prefix) else []
        for depth in range(1, len(inner)):
            if recursive or depth == 1:
                folders.add(prefix + "/".join(inner[:depth]))
        if inner and (recursive or len(inner) == 1):
            entry: dict[str, Any] = {"type": "file", "path": path, "size": len(content), "oid": git_oid(content)}
            if is_lfs(path):
                entry["lfs"] = {"oid": hashlib.sha256(content).hexdigest(), "size": len(content), "pointerSize": 130}
            yield entry
    for folder in sorted(folders):
        yield {"type": "directory", "path": folder, "oid": hashlib.sha1(folder.encode()).hexdigest(), "size": 0}
