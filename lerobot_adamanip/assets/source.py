"""External assets: which ones a folder holds, which of them can be used, and loading them by id."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lerobot_adamanip.assets.annotation.file import ANNOTATION_NAME
from lerobot_adamanip.assets.loading import PlacementCheck, inspect_object, load_object, problem_of
from lerobot_adamanip.assets.names import asset_id, name_problem, parse_asset_id, shown_name
from lerobot_adamanip.assets.notices import warn_once
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.objects.base import ArticulatedObject
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

URDF_NAME = "mobility.urdf"
"""What every layout calls its description."""


@dataclass(frozen=True)
class AssetSource:
    """The external assets under a directory.

    Objects of a category are the folders with a ``mobility.urdf`` in ``DIR/<category>`` (or AdaManip's own name for
    it, as ``coffee_machine``), or, if there is none of those, in ``DIR`` itself. A folder whose ``adamanip.json`` (or
    PartNet-Mobility ``meta.json``) names another category is passed over.

    Attributes:
        directory: see above.
        placement_problem: says why an object cannot be placed before the arm; None: nobody asks. Objects that cannot
            be placed are left out like those that cannot be loaded.
    """

    directory: str | Path
    placement_problem: PlacementCheck | None = None

    def ids(self, category: str) -> tuple[str, ...]:
        """Returns the ids of the objects of a category, sorted; folders whose name cannot be an id have none.

        Raises:
            ConfigurationError: no such directory, or no object of that category in it.
        """
        found = self._found(category)
        named = tuple(asset_id(category, each.name) for each in found if not each.problem)
        return named or self._usable(category, found)

    def folder(self, identifier: str) -> Path:
        """Returns the folder of an object.

        Raises:
            ConfigurationError: the id is none, or there is no such folder.
        """
        category, name = parse_asset_id(identifier)
        folders = _folders(Path(self.directory), category)
        for each in folders:
            if each.name == name:
                return each.folder
        raise ConfigurationError(
            f"There is no object {identifier!r} under {self.directory}.",
            got=identifier,
            allowed=_some(each.name for each in folders if not each.problem),
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
            return self._usable(category, self._found(category))
        chosen: tuple[str, ...] = ()
        if match := re.fullmatch(r"(\d+):(\d+)", selection):
            named = [each for each in self._found(category) if not each.problem]
            if within := named[int(match[1]) : int(match[2])]:
                return self._usable(category, within)
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
        return bool(self._of_category(category))

    def check(self, category: str) -> tuple[AssetReport, ...]:
        """Returns, per folder of a category, whether it can be used, and why not.

        Raises:
            ConfigurationError: no such directory, or no folder of that category in it.
        """
        return tuple(self._report(category, each) for each in self._found(category))

    def _report(self, category: str, found: _Folder) -> AssetReport:
        problem = found.problem or problem_of(found.folder, category, self.placement_problem)
        return AssetReport(f"{category}:{shown_name(found.name)}", problem)

    def _of_category(self, category: str) -> list[_Folder]:
        folders = _folders(Path(self.directory), require_choice("category", category, ROLES))
        return [each for each in folders if _category_of(each.folder) in (None, category)]

    def _found(self, category: str) -> list[_Folder]:
        if found := self._of_category(category):
            return found
        raise _nothing_found(Path(self.directory), category)

    def _usable(self, category: str, found: Sequence[_Folder]) -> tuple[str, ...]:
        reports = [self._report(category, each) for each in found]
        usable = tuple(report.asset_id for report in reports if report.usable)
        listed = "\n".join(f"  {report.asset_id}: {report.problem}" for report in reports if not report.usable)
        check = f"adamanip objects --assets {self.directory} --category {category}"
        if not usable:
            raise ConfigurationError(
                f"No {category} under {self.directory} can be used.",
                got=f"\n{listed}",
                allowed="a folder that can be loaded and placed, with a goal that its joints reach",
                hint=check,
            )
        if listed:
            left_out = f"{len(reports) - len(usable)} of {len(reports)} external assets are left out"
            warn_once(f"{left_out} ({check}):\n{listed}")
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


@dataclass(frozen=True)
class _Folder:
    """A folder with a URDF: its name, where it is, and why the name cannot be an id (empty: it can)."""

    name: str
    folder: Path
    problem: str = ""


def _folders(directory: Path, category: str) -> list[_Folder]:
    """The object folders in ``directory/<category>``, else in ``directory``; sorted by name."""
    if not directory.is_dir():
        raise ConfigurationError(
            "The folder of external assets does not exist.",
            got=str(directory),
            allowed="a directory of folders that hold a mobility.urdf",
            hint="--env.assets=DIR",
        )
    inner = [directory / name for name in ROLES[category].folders if (directory / name).is_dir()]
    found: list[_Folder] = []
    for place in inner or [directory]:
        for folder in place.iterdir():
            if not folder.name.startswith(".") and os.path.isfile(folder / URDF_NAME):
                found.append(_Folder(folder.name, folder, _name_problem(folder, [each.folder for each in found])))
    return sorted(found, key=lambda each: (each.name, bool(each.problem)))


def _name_problem(folder: Path, others: Iterable[Path]) -> str:
    """Why a folder's name cannot be an id: an id stands for one folder."""
    same = next((other for other in others if other.name == folder.name), None)
    if same is None:
        return name_problem(folder.name)
    return f"{same.parent.name}/ has a folder of the same name, which is used: rename this one in {folder.parent.name}/"


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
