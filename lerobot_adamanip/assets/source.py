"""External assets in a folder: listing, checking, and loading them by id, for instance ``safe:sa1``."""

from __future__ import annotations

import functools
import os
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lerobot_adamanip.assets.annotation.file import ANNOTATION_NAME
from lerobot_adamanip.assets.checked_xml import warn_once_about_asset
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.assets.urdf import URDF_NAME
from lerobot_adamanip.objects.base import ArticulatedObject
from lerobot_adamanip.util.errors import ConfigurationError, listed, require_choice
from lerobot_adamanip.util.json_fields import read

PlacementCheck = Callable[[ArticulatedObject], str]
"""Returns why the arm's scene cannot place an object, or an empty text. The simulator's package provides one."""
MAX_NAME_BYTES = 100
"""Maximum length of an id: ids are parts of file names, and datasets limit them."""
ALLOWED_NAMES = f"letters, digits, spaces and _ . + -, no dot or space first, no space last, {MAX_NAME_BYTES} bytes"


def parse_asset_id(identifier: str) -> tuple[str, str]:
    """Returns ("safe", "sa1") for ``safe:sa1``; raises `ConfigurationError` for anything else."""
    category, colon, name = identifier.partition(":")
    if not colon or category not in ROLES or name_problem(name):
        raise ConfigurationError(
            "Unknown object id.",
            got=repr(identifier),
            allowed=f"<category>:<folder>, category one of {', '.join(ROLES)}; folder of {ALLOWED_NAMES}",
            hint="safe:sa1, with --env.assets=DIR and DIR/safe/sa1/mobility.urdf",
        )
    return category, name


def name_problem(name: str) -> str:
    """Returns why a folder name cannot be part of an id; empty if it can.

    Separators of paths, ids and selections are rejected, because an id becomes part of a file name.
    """
    if len(name.encode(errors="surrogatepass")) <= MAX_NAME_BYTES and re.fullmatch(r"[\w+-]([\w.+ -]*[\w.+-])?", name):
        return ""
    return f"a folder with this name cannot be an object ({name[:40]!a}; {ALLOWED_NAMES}): rename the folder"


def load_object(folder: str | Path, category: str, *, solid: bool = True) -> ArticulatedObject:
    """Loads ``folder/mobility.urdf`` and its annotation as an object of ``category``, in this project's object frame.

    Joints and parts get the category's names (`ROLES`); joints without a role are fixed at zero. The grasp comes from
    ``adamanip.json``, otherwise from AdaManip's or UniDoorManip's annotated point. Unchanged files are cached. Without
    ``solid``, the object has no collision shapes, whose computation may be slow.

    Raises:
        ConfigurationError: a file is missing, broken or not allowed; the message says what to do.
    """
    path = _named(Path(folder))
    return _load_cached(path, require_choice("category", category, ROLES), solid, _stamps(path))


Stamps = tuple[tuple[str, int, int], ...]
"""Name, time [ns] and size [bytes] of every file in a folder; detects edited files."""


def _stamps(folder: Path) -> Stamps:
    files = [(file, file.stat()) for file in sorted(folder.rglob("*")) if file.is_file()]
    return tuple((str(file.relative_to(folder)), stat.st_mtime_ns, stat.st_size) for file, stat in files)


@functools.lru_cache(maxsize=64)
def _load_cached(folder: Path, category: str, solid: bool, stamps: Stamps) -> ArticulatedObject:
    from lerobot_adamanip.assets.convert import convert_asset

    return convert_asset(folder, category, solid)


@functools.lru_cache(maxsize=1024)
def _problem_cached(placement_problem: PlacementCheck | None, folder: Path, category: str, stamps: Stamps) -> str:
    try:
        obj = _load_cached(folder, category, False, stamps)
    except (ConfigurationError, OSError) as error:
        lines = str(error).replace(f"{folder}/", "").replace(f"{folder.resolve()}/", "").splitlines()
        facts = [line.split(":", 1)[1].strip() for line in lines[1:] if line.strip().startswith("got:")]
        return " ".join([lines[0], *(f"({fact})" for fact in facts)])
    return "" if placement_problem is None else placement_problem(obj)


def _named(folder: Path) -> Path:
    """Returns the absolute path, keeping the folder's own name if it is a link."""
    return folder.resolve() if folder.name in ("", "..") else folder.absolute()


@dataclass(frozen=True)
class AssetReport:
    """Result of checking one folder: the asset's id, and the problem that makes it unusable (empty: none)."""

    asset_id: str
    problem: str
    folder: Path

    @property
    def usable(self) -> bool:
        """Whether the asset has no problem."""
        return not self.problem


@dataclass(frozen=True)
class AssetSource:
    """External assets in a directory.

    Objects of a category are the folders with a ``mobility.urdf`` in ``DIR/<category>`` (or AdaManip's name for it,
    ``coffee_machine``), otherwise those in ``DIR`` itself. A folder is skipped if its ``adamanip.json`` (or
    PartNet-Mobility ``meta.json``) names another category.

    Attributes:
        directory: see above.
        placement_problem: returns why an object cannot be placed in front of the arm; None for no check. Objects that
            cannot be placed are left out, as those that cannot be loaded.
    """

    directory: str | Path
    placement_problem: PlacementCheck | None = None

    def ids(self, category: str) -> tuple[str, ...]:
        """Returns the sorted object ids of a category; skips folders whose name cannot be an id.

        Raises:
            ConfigurationError: the directory does not exist, or has no object of that category.
        """
        candidates = self._candidates(category)
        return tuple(each.asset_id for each in candidates if each.usable) or self._usable(category, candidates)

    def folder(self, identifier: str) -> Path:
        """Returns the folder of an object; raises `ConfigurationError` if the id or the folder does not exist."""
        category, name = parse_asset_id(identifier)
        folders = _folders(Path(self.directory), category)
        for each in folders:
            if each.folder.name == name:
                return each.folder
        raise ConfigurationError(
            f"There is no object {identifier!r} under {self.directory}.",
            got=identifier,
            allowed=listed([each.folder.name for each in folders if each.usable]) or "none",
            hint=f"the id {category}:<folder> of a folder with a {URDF_NAME}",
        )

    def load(self, identifier: str, *, solid: bool = True) -> ArticulatedObject:
        """Loads an object by id; see `load_object`."""
        return load_object(self.folder(identifier), parse_asset_id(identifier)[0], solid=solid)

    def select(self, category: str, selection: str) -> tuple[str, ...]:
        """Returns ids for ``seen`` or ``all`` (every folder), ``0:4`` (a range of the sorted ids), or ``id,id``.

        ``seen``, ``all`` and ranges omit unusable folders, with one warning that lists them. An explicit id is kept;
        loading it raises its error.

        Raises:
            ConfigurationError: the selection is invalid or empty, or nothing in it is usable. ``unseen`` and ``novel``
                are rejected, because only the user knows which objects were seen in training.
        """
        if selection in ("seen", "all"):
            return self._usable(category, self._candidates(category))
        chosen: tuple[str, ...] = ()
        if match := re.fullmatch(r"(\d{1,6}):(\d{1,6})", selection):
            named = [each for each in self._candidates(category) if each.usable]
            if within := named[int(match[1]) : int(match[2])]:
                return self._usable(category, within)
        elif not selection.startswith(("unseen", "novel")):
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
        """Returns whether the category has a folder, usable or not."""
        return bool(self._of_category(category))

    def check(self, category: str) -> tuple[AssetReport, ...]:
        """Returns a report for each folder of a category; raises `ConfigurationError` if there is none."""
        return tuple(self._report(category, each) for each in self._candidates(category))

    def _report(self, category: str, candidate: AssetReport) -> AssetReport:
        path = _named(candidate.folder)
        problem = candidate.problem or _problem_cached(self.placement_problem, path, category, _stamps(path))
        return replace(candidate, problem=problem)

    def _of_category(self, category: str) -> list[AssetReport]:
        folders = _folders(Path(self.directory), require_choice("category", category, ROLES))
        return [each for each in folders if _category_of(each.folder) in (None, category)]

    def _candidates(self, category: str) -> list[AssetReport]:
        if candidates := self._of_category(category):
            return candidates
        raise ConfigurationError(
            f"No {category} found.",
            got=str(self.directory),
            allowed=f"folders with a {URDF_NAME} in DIR or in DIR/{' or DIR/'.join(ROLES[category].folders)}",
            hint="the folder into which you unpacked the assets",
        )

    def _usable(self, category: str, candidates: Sequence[AssetReport]) -> tuple[str, ...]:
        reports = [self._report(category, each) for each in candidates]
        usable = tuple(report.asset_id for report in reports if report.usable)
        listed = "\n".join(f"  {report.asset_id}: {report.problem}" for report in reports if not report.usable)
        check = f"adamanip objects --assets {shlex.quote(str(self.directory))} --category {category}"
        if not usable:
            raise ConfigurationError(
                f"No {category} under {self.directory} can be used.",
                got=f"\n{listed}",
                allowed="a folder that can be loaded and placed, with a goal that its joints reach",
                hint=check,
            )
        if listed:
            left_out = f"{len(reports) - len(usable)} of {len(reports)} external assets are left out"
            warn_once_about_asset(f"{left_out} ({check}):\n{listed}")
        return usable


def require_directory(directory: Path) -> None:
    """Raises `ConfigurationError` if a folder of external assets does not exist."""
    if not os.path.isdir(directory):  # `Path.is_dir` raises an error for a name that is too long
        raise ConfigurationError(
            "The folder of external assets does not exist.",
            got=str(directory),
            allowed="a directory of folders that hold a mobility.urdf",
            hint="--env.assets=DIR",
        )


def _folders(directory: Path, category: str) -> list[AssetReport]:
    """Returns the object folders in ``directory/<category>``, otherwise in ``directory``; checks only their names."""
    require_directory(directory)
    inner = [directory / name for name in ROLES[category].folders if (directory / name).is_dir()]
    used: dict[str, Path] = {}
    candidates = []
    for folder in (folder for place in inner or [directory] for folder in place.iterdir()):
        if folder.name.startswith(".") or not os.path.isfile(folder / URDF_NAME):
            continue
        problem, other = name_problem(folder.name), used.setdefault(folder.name, folder).parent.name
        if used[folder.name] != folder:
            problem = f"{other}/ has a folder of the same name, which is used: rename this one in {folder.parent.name}/"
        # Non-printable characters are escaped.
        shown = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in folder.name)
        candidates.append(AssetReport(f"{category}:{shown}", problem, folder))
    return sorted(candidates, key=lambda each: (each.folder.name, not each.usable))


def _category_of(folder: Path) -> str | None:
    """Returns the category in a folder's metadata; an empty text for an unknown one, None without metadata."""
    said = _json_value(folder / ANNOTATION_NAME, "category")
    if said is not None:
        return str(said)
    said = _json_value(folder / "meta.json", "model_cat")
    if said is None:
        return None
    return next((name for name, roles in ROLES.items() if said in roles.partnet), "")


def _json_value(path: Path, key: str) -> object:
    # A broken file raises its error when the object is loaded; it is ignored here.
    try:
        value = read(path)
    except (OSError, ValueError):
        return None
    return value.get(key) if isinstance(value, dict) else None
