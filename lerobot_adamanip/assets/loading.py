"""Loading an external asset's folder, once: what has not changed on disk is not read again."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.objects.base import ArticulatedObject
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

Stamps = tuple[tuple[str, int, int], ...]
"""Name, time [ns] and size [bytes] of each file."""


def load_object(folder: str | Path, category: str) -> ArticulatedObject:
    """Loads ``folder/mobility.urdf`` and its annotation as an object of ``category``, in our object frame.

    Joints and parts get the category's own names (`ROLES`); joints that play no role are frozen at zero. The grasp
    comes from ``adamanip.json`` or, if there is none, from AdaManip's or UniDoorManip's annotated point.

    Args:
        folder: of one object.
        category: that it is of.

    Raises:
        ConfigurationError: anything is missing, broken, or not allowed; the message says what to do.
    """
    from lerobot_adamanip.assets.convert import convert_asset

    path = _named(Path(folder))
    return _load_cached(convert_asset, path, require_choice("category", category, ROLES), _stamps(path))


def _stamps(folder: Path) -> Stamps:
    """Name, time and size of every file under a folder: an edited annotation or mesh makes another object."""
    found = []
    for file in sorted(folder.rglob("*")):
        if file.is_file():
            told = file.stat()
            found.append((str(file.relative_to(folder)), told.st_mtime_ns, told.st_size))
    return tuple(found)


@functools.lru_cache(maxsize=64)
def _load_cached(
    build: Callable[[Path, str], ArticulatedObject], folder: Path, category: str, stamps: Stamps
) -> ArticulatedObject:
    del stamps
    return build(folder, category)


def inspect_object(folder: Path, category: str) -> ArticulatedObject:
    """Loads an object without the shapes it collides as, which may take long to make; all else as `load_object`."""
    from lerobot_adamanip.assets.convert import inspect_asset

    return inspect_asset(_named(folder), category)


PlacementCheck = Callable[[ArticulatedObject], str]
"""Says why an object cannot be placed before the arm; an empty text if it can. The simulator's package has one."""


def problem_of(folder: Path, category: str, placement_problem: PlacementCheck | None = None) -> str:
    """Returns what keeps a folder from being used, an empty text if nothing does; collisions are not made for that.

    Args:
        folder: of one object.
        category: that it is of.
        placement_problem: also asked, if the object can be loaded.
    """
    from lerobot_adamanip.assets.convert import inspect_asset

    path = _named(folder)
    return _problem_cached(inspect_asset, placement_problem, path, category, _stamps(path))


@functools.lru_cache(maxsize=1024)
def _problem_cached(
    inspect: Callable[[Path, str], ArticulatedObject],
    placement_problem: PlacementCheck | None,
    folder: Path,
    category: str,
    stamps: Stamps,
) -> str:
    del stamps
    try:
        obj = inspect(folder, category)
    except (ConfigurationError, OSError) as error:
        return _in_one_line(error, folder)
    return "" if placement_problem is None else placement_problem(obj)


def _named(folder: Path) -> Path:
    """The absolute path that keeps the folder's own name: a link's object is called as the link is."""
    return folder.resolve() if folder.name in ("", "..") else folder.absolute()


def _in_one_line(error: Exception, folder: Path) -> str:
    """What went wrong and what was found, without the folder's path and without advice."""
    told = str(error).replace(f"{folder}/", "").replace(f"{folder.resolve()}/", "").splitlines()
    facts = [line.split(":", 1)[1].strip() for line in told[1:] if line.strip().startswith("got:")]
    return " ".join([told[0], *(f"({fact})" for fact in facts)])
