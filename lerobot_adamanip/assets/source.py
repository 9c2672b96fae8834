"""External assets: which ones a folder holds, which of them can be used, and loading them by id."""

from __future__ import annotations

import functools
import json
import logging
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.assets.annotation.file import ANNOTATION_NAME
from lerobot_adamanip.assets.loading import inspect_object, load_object, problem_of
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.errors import ConfigurationError, require_choice
from lerobot_adamanip.objects.base import ArticulatedObject

logger = logging.getLogger(__name__)

URDF_NAME = "mobility.urdf"
"""What every layout calls its description."""


def is_asset_id(identifier: str) -> bool:
    """Whether an id names an external asset (``safe:sa1``) rather than a generated one (``safe_001``)."""
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
    """The external assets under a directory.

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

    def inspect(self, identifier: str) -> ArticulatedObject:
        """Loads an object without the shapes it collides as: quick, to look at it; errors as `load_object`."""
        return inspect_object(self.folder(identifier), parse_asset_id(identifier)[0])

    def select(self, category: str, selection: str) -> tuple[str, ...]:
        """Returns ids for ``seen`` or ``all`` (every folder), ``0:4`` (a range of them, sorted), or ``id,id``.

        Folders that cannot be used are left out of ``seen``, ``all`` and ranges, with one warning that lists them;
        an id that is named is kept, and loading it says what is wrong.

        Raises:
            ConfigurationError: the selection is none of these, or empty, or nothing in it can be used. ``unseen`` and
                ``novel`` are refused: which of somebody's objects were seen is theirs to say.
        """
        if selection in ("seen", "all"):
            return self._usable(category, self.ids(category))
        chosen: tuple[str, ...] = ()
        if match := re.fullmatch(r"(\d+):(\d+)", selection):
            chosen = self.ids(category)[int(match[1]) : int(match[2])]
            if chosen:
                return self._usable(category, chosen)
        elif selection not in ("unseen", "novel"):
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

    def holds(self, category: str) -> bool:
        """Returns whether there is a folder of that category, usable or not."""
        folders = _folders(Path(self.directory), require_choice("category", category, ROLES))
        return any(_category_of(folder) in (None, category) for folder in folders)

    def check(self, category: str) -> tuple[AssetReport, ...]:
        """Returns, per folder of a category, whether it can be used, and why not; see `ids` for errors."""
        return tuple(AssetReport(name, problem_of(self.folder(name), category)) for name in self.ids(category))

    def _usable(self, category: str, ids: tuple[str, ...]) -> tuple[str, ...]:
        problems = {name: problem_of(self.folder(name), category) for name in ids}
        usable = tuple(name for name, problem in problems.items() if not problem)
        listed = "\n".join(f"  {name}: {problem}" for name, problem in problems.items() if problem)
        check = f"adamanip objects --assets {self.directory} --category {category}"
        if not usable:
            raise ConfigurationError(
                f"No {category} under {self.directory} can be used.",
                got=f"\n{listed}",
                allowed="a folder that can be loaded, with a goal that its joints reach",
                hint=check,
            )
        if listed:
            _warn_once(f"{len(ids) - len(usable)} of {len(ids)} external assets are left out ({check}):\n{listed}")
        return usable


@dataclass(frozen=True)
class AssetReport:
    """What a check of one folder found: the asset's id, and what keeps it from being used (empty: nothing)."""

    asset_id: str
    problem: str

    @property
    def usable(self) -> bool:
        """Whether nothing keeps it from being used."""
        return not self.problem


def asset_objects(directory: str | Path, category: str) -> tuple[str, ...]:
    """Returns the ids of the objects of a category under a directory; see `AssetSource.ids`."""
    return AssetSource(Path(directory)).ids(category)


def load_asset(directory: str | Path, identifier: str) -> ArticulatedObject:
    """Loads an object of a directory by its id; see `load_object`."""
    return AssetSource(Path(directory)).load(identifier)


@functools.cache
def _warn_once(text: str) -> None:
    logger.warning("%s", text)


def _folders(directory: Path, category: str) -> list[Path]:
    """The object folders in ``directory/<category>``, else in ``directory``; sorted by name."""
    if not directory.is_dir():
        raise ConfigurationError(
            "The folder of external assets does not exist.",
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
