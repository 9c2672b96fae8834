"""Files that a URDF, mesh or material refers to; only files inside the object's folder are accepted."""

from __future__ import annotations

import os
import posixpath
import unicodedata
from pathlib import Path, PurePosixPath
from typing import Any

from lerobot_adamanip.util.errors import ConfigurationError

MAX_BYTES = 256_000_000
"""Larger than any mesh, material or texture of a household object."""


class MissingFileError(ConfigurationError):
    """A referenced file that does not exist in the folder."""


def inside(folder: Path, name: str) -> Path:
    """Returns a file that a URDF refers to, which must be inside the object's folder.

    Args:
        folder: folder of the object.
        name: relative to the folder. ``package://name/rest`` is searched as ``rest`` and ``name/rest``. A name in
            different case is accepted if it matches one file.

    Raises:
        MissingFileError: the file does not exist.
        ConfigurationError: the path leaves the folder (``..``, absolute, another scheme, a link).
    """
    root, text = folder.resolve(), name.strip().replace("\\", "/")
    rest = text.removeprefix("package://")
    tries = [posixpath.normpath(each) for each in ([rest] if rest == text else [rest.partition("/")[2], rest]) if each]
    if "://" in rest or any(map(_leads_out, tries)):
        raise _refused(folder, name, "a file outside its folder, which is not read")
    path = next((path for each in tries if (path := present(root, each)) is not None), None)
    if path is None:
        raise missing_file(folder, name)
    if not path.resolve().is_relative_to(root):
        raise _refused(folder, name, "a link out of its folder, which is not followed")
    return path.resolve()


def missing_file(folder: Path, name: str) -> ConfigurationError:
    """Returns the error for a referenced file that does not exist in the folder."""
    return _refused(folder, name, "a file that is missing", MissingFileError)


def present(root: Path, relative: str) -> Path | None:
    """Returns the file at a relative path, otherwise the only file that matches it except for case, otherwise None."""
    if os.path.isfile(root / relative):  # False, not an error, for an impossible name
        return root / relative
    here = root
    for part in PurePosixPath(relative).parts:
        if not here.resolve().is_relative_to(root) or not here.is_dir():
            return None
        alike = [each for each in os.listdir(here) if _folded(each) == _folded(part)]
        if part not in alike and len(alike) != 1:
            return None
        here = here / (part if part in alike else alike[0])
    return here if os.path.isfile(here) else None


def resolver(folder: Path, base: Path) -> Any:
    """Returns trimesh's resolver of the files that a mesh refers to, limited to the folder."""
    import trimesh

    root = folder.resolve()

    class Inside(trimesh.resolvers.FilePathResolver):
        def get(self, name: str) -> bytes:
            text = str(name).strip().replace("\\", "/")
            relative = posixpath.normpath(posixpath.join(base.relative_to(root).as_posix(), text))
            path = None if _leads_out(relative) else present(root, relative)
            if path is None or not path.resolve().is_relative_to(root) or path.stat().st_size > MAX_BYTES:
                raise FileNotFoundError(f"{name} is not inside {root}")
            return path.read_bytes()

    return Inside(str(base))


def _leads_out(relative: str) -> bool:
    return relative == ".." or relative.startswith(("../", "/")) or "\0" in relative


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def _refused(
    folder: Path, name: str, what: str, kind: type[ConfigurationError] = ConfigurationError
) -> ConfigurationError:
    last = _folded(name.replace("\\", "/").rpartition("/")[2].strip())
    root = folder.resolve()
    alike = sorted(each for each in root.rglob("*") if last and _folded(each.name) == last and not each.is_symlink())
    hint = "unpack the whole archive, or copy the file into the folder and name it relative to the folder"
    if alike:
        hint = f"name it {alike[0].relative_to(root).as_posix()!r}, where the folder has such a file"
    return kind(
        f"{folder / 'mobility.urdf'}: names {what}.",
        got=repr(name[:120]),
        allowed=f"files inside {folder.name}/, named relative to it",
        hint=hint,
    )
