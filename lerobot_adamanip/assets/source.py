"""Which foreign objects a directory holds, and loading them by id."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.errors import ConfigurationError, require_choice
from lerobot_adamanip.objects.base import ArticulatedObject

URDF_NAME = "mobility.urdf"
"""What every layout calls its description."""
ANNOTATION_NAME = "adamanip.json"
"""What `adamanip annotate` saves beside it."""


def is_asset_id(identifier: str) -> bool:
    """Whether an id names a foreign object (``safe:sa1``) rather than a generated one (``safe_001``)."""
    return ":" in identifier


def asset_id(category: str, name: str) -> str:
    """Returns ``safe:sa1`` for ("safe", "sa1")."""
    return f"{require_choice('category', category, ROLES)}:{_checked_name(name)}"


def parse_asset_id(identifier: str) -> tuple[str, str]:
    """Returns ("safe", "sa1") for ``safe:sa1``; raises `ConfigurationError` for anything else."""
    category, colon, name = identifier.partition(":")
    if not colon or category not in ROLES:
        raise ConfigurationError(
            "Unknown object id.",
            got=repr(identifier),
            allowed=f"<category>:<folder>, category one of {', '.join(ROLES)}",
            hint="safe:sa1, with --env.assets=DIR and DIR/safe/sa1/mobility.urdf",
        )
    return category, _checked_name(name)


def _checked_name(name: str) -> str:
    # No separators of paths, ids or selections: an id can be a file's name, and cannot leave its directory.
    if re.fullmatch(r"[\w+-][\w.+ -]*", name):
        return name
    raise ConfigurationError(
        "A folder with this name cannot be an object.",
        got=repr(name),
        allowed="letters, digits, spaces and _ . + -, no dot first",
        hint="rename the folder",
    )


@dataclass(frozen=True)
class AssetSource:
    """The foreign objects under a directory.

    Objects of a category are the folders with a ``mobility.urdf`` in ``DIR/<category>`` (or AdaManip's own name for
    it, as ``coffee_machine``), or, if there is none of those, in ``DIR`` itself. A folder whose ``adamanip.json`` (or
    PartNet-Mobility ``meta.json``) names another category is passed over.
    """

    directory: str | Path

    def ids(self, category: str) -> tuple[str, ...]:
        """Returns the ids of the objects of a category, sorted.

        Raises:
            ConfigurationError: no such directory, or no object of that category in it.
        """
        folders = _folders(Path(self.directory), require_choice("category", category, ROLES))
        found = [folder for folder in folders if _category_of(folder) in (None, category)]
        if not found:
            raise _nothing_found(Path(self.directory), category)
        return tuple(asset_id(category, folder.name) for folder in found)

    def folder(self, identifier: str) -> Path:
        """Returns the folder of an object.

        Raises:
            ConfigurationError: the id is none, or there is no such folder.
        """
        category, name = parse_asset_id(identifier)
        for folder in _folders(Path(self.directory), category):
            if folder.name == name:
                return folder
        raise ConfigurationError(
            f"There is no object {identifier!r} under {self.directory}.",
            got=identifier,
            allowed=_some(folder.name for folder in _folders(Path(self.directory), category)),
            hint=f"the id {category}:<folder> of a folder with a {URDF_NAME}",
        )

    def load(self, identifier: str) -> ArticulatedObject:
        """Loads an object by id; see `load_object`."""
        return load_object(self.folder(identifier), parse_asset_id(identifier)[0])

    def select(self, category: str, selection: str) -> tuple[str, ...]:
        """Returns ids for ``seen`` or ``all`` (every folder), ``0:4`` (a range of them, sorted), or ``id,id``.

        Raises:
            ConfigurationError: the selection is none of these, or empty. ``unseen`` is refused: which of somebody's
                objects were seen is theirs to say.
        """
        if selection in ("seen", "all"):
            return self.ids(category)
        chosen: tuple[str, ...] = ()
        if match := re.fullmatch(r"(\d+):(\d+)", selection):
            chosen = self.ids(category)[int(match[1]) : int(match[2])]
        elif selection != "unseen":
            chosen = tuple(name.strip() for name in selection.split(",") if name.strip())
        if not chosen or any(parse_asset_id(name)[0] != category for name in chosen):
            raise ConfigurationError(
                f"Wrong selection of objects for category {category!r} under {self.directory}.",
                got=repr(selection),
                allowed=f"all | FIRST:END | {category}:<folder>,{category}:<folder>,...",
                hint="all",
            )
        for name in chosen:
            self.folder(name)
        return chosen


def asset_objects(directory: str | Path, category: str) -> tuple[str, ...]:
    """Returns the ids of the objects of a category under a directory; see `AssetSource.ids`."""
    return AssetSource(Path(directory)).ids(category)


def load_asset(directory: str | Path, identifier: str) -> ArticulatedObject:
    """Loads an object of a directory by its id; see `load_object`."""
    return AssetSource(Path(directory)).load(identifier)


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

    path = Path(folder).resolve()
    stamps = tuple(
        (file.name, file.stat().st_mtime_ns) for file in sorted(path.glob("*")) if file.is_file()
    )  # an object edited by the annotation tool is another object
    return _load_cached(convert_asset, path, require_choice("category", category, ROLES), stamps)


@functools.lru_cache(maxsize=64)
def _load_cached(build: object, folder: Path, category: str, stamps: object) -> ArticulatedObject:
    del stamps
    return build(folder, category)  # type: ignore[operator, no-any-return]


def _folders(directory: Path, category: str) -> list[Path]:
    """The object folders in ``directory/<category>``, else in ``directory``; sorted by name."""
    if not directory.is_dir():
        raise ConfigurationError(
            "The directory of foreign objects does not exist.",
            got=str(directory),
            allowed="a directory of folders that hold a mobility.urdf",
            hint="--env.assets=DIR",
        )
    inner = [directory / name for name in ROLES[category].folders if (directory / name).is_dir()]
    found: dict[str, Path] = {}
    for place in inner or [directory]:
        for urdf in place.glob(f"*/{URDF_NAME}"):
            if urdf.is_file() and not urdf.parent.name.startswith("."):
                found.setdefault(urdf.parent.name, urdf.parent)
    return [found[name] for name in sorted(found)]


def _category_of(folder: Path) -> str | None:
    """The category a folder says it is of: ours by name, another's as an empty text, None if it says nothing."""
    said = _json_value(folder / ANNOTATION_NAME, "category")
    if said is not None:
        return str(said)
    said = _json_value(folder / "meta.json", "model_cat")
    if said is None:
        return None
    return next((name for name, roles in ROLES.items() if said in roles.partnet), "")


def _json_value(path: Path, key: str) -> object:
    # A broken file is reported when the object is loaded; here it says nothing.
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return value.get(key) if isinstance(value, dict) else None


def _some(names: Iterable[str], count: int = 12) -> str:
    listed = list(names)
    return ", ".join(listed[:count]) + (f", ... ({len(listed)})" if len(listed) > count else "") or "none"


def _nothing_found(directory: Path, category: str) -> ConfigurationError:
    return ConfigurationError(
        f"No {category} found.",
        got=str(directory),
        allowed=f"folders with a {URDF_NAME} in DIR or in DIR/{' or DIR/'.join(ROLES[category].folders)}",
        hint="the folder into which you unpacked the assets",
    )
