"""Catalog of objects, generated and external: ids, selections of ids, and the object of an id.

Generated objects come in three splits: *seen* (``safe_000`` ... ``safe_035``: demonstrations are collected on them),
*unseen* (higher numbers: new draws of the same kinds) and *novel* (``safe_n000`` and up: kinds, combinations and
proportions that no seen object has). External assets (``safe:sa1``) belong to no split.
"""

from __future__ import annotations

import functools
import importlib
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from lerobot_adamanip.contract.categories import CATEGORIES, is_asset_id
from lerobot_adamanip.util.errors import ConfigurationError, require_choice

if TYPE_CHECKING:  # assets and objects need scipy, and a command checks its ids first
    from lerobot_adamanip.assets import PlacementCheck
    from lerobot_adamanip.objects.base import ArticulatedObject

SEEN_COUNTS = {name: category.seen for name, category in CATEGORIES.items()}
"""Objects per category in the paper (its Table 1)."""
UNSEEN_COUNT = 20
"""Number of objects per category in each of the selections ``unseen`` and ``novel``."""
FOR_TESTS = "_test"
"""Ending of the selections ``unseen_test`` and ``novel_test``: the next objects of a split, for reported numbers."""
ObjectSplit = Literal["seen", "unseen", "novel"]


def object_id(category: str, number: int, *, novel: bool = False) -> str:
    """Returns ``safe_007`` for ("safe", 7), and ``safe_n007`` for the novel object of that number."""
    return f"{require_choice('category', category, CATEGORIES)}_{'n' if novel else ''}{number:03d}"


def parse_object_id(identifier: str) -> tuple[str, int]:
    """Returns ("safe", 7) for ``safe_007`` and for ``safe_n007``; raises `ConfigurationError` for anything else.

    The number does not say which split the object belongs to: see `object_split`.
    """
    match = re.fullmatch(r"([a-z_]+)_n?([0-9]{3}|[1-9][0-9]{3,5})", identifier)  # one object, one id
    if match is None or match[1] not in CATEGORIES:
        raise ConfigurationError(
            "Unknown object id.",
            got=repr(identifier),
            allowed=f"<category>_<number> or <category>_n<number>, category one of {', '.join(CATEGORIES)}",
            hint="safe_000",
        )
    return match[1], int(match[2])


def object_split(identifier: str) -> ObjectSplit | None:
    """Returns the split of a generated object; None for an external asset.

    Raises:
        ConfigurationError: it is not an object id.
    """
    if is_asset_id(identifier):
        return None
    category, number = parse_object_id(identifier)
    if _is_novel(identifier):
        return "novel"
    return "seen" if number < SEEN_COUNTS[category] else "unseen"


def _is_novel(identifier: str) -> bool:
    return identifier.rpartition("_")[2].startswith("n")


@functools.lru_cache(maxsize=64)
def make_object(identifier: str) -> ArticulatedObject:
    """Builds an object by id. Deterministic: one id is one object, everywhere."""
    category, number = parse_object_id(identifier)
    novel = _is_novel(identifier)
    generator = importlib.import_module(f"lerobot_adamanip.objects.{category}")
    result: ArticulatedObject = getattr(generator, f"make_{'novel_' if novel else ''}{category}")(number)
    return result


def seen_objects(category: str) -> tuple[str, ...]:
    """Returns the ids of the seen objects, as many as in the paper; demonstrations are collected on them."""
    count = SEEN_COUNTS[require_choice("category", category, CATEGORIES)]
    return tuple(object_id(category, number) for number in range(count))


def unseen_objects(category: str, count: int = UNSEEN_COUNT) -> tuple[str, ...]:
    """Returns the ids of the first ``count`` objects beyond the seen ones: new draws of the same kinds."""
    start = SEEN_COUNTS[require_choice("category", category, CATEGORIES)]
    return tuple(object_id(category, number) for number in range(start, start + count))


def novel_objects(category: str, count: int = UNSEEN_COUNT) -> tuple[str, ...]:
    """Returns the ids of the first ``count`` objects of kinds and combinations that no seen object has."""
    return tuple(object_id(category, number, novel=True) for number in range(count))


def parse_object_selection(category: str, selection: str) -> tuple[str, ...]:
    """Returns object ids for a selection.

    Args:
        category: category of the objects.
        selection: ``seen``, ``unseen``, ``novel``, ``unseen_test``, ``novel_test`` (see `FOR_TESTS`), ``0:4`` (a range
            of numbers; of novel ones, ``n0:n4``), or ``safe_000,safe_n007``.

    Raises:
        ConfigurationError: the selection is none of these, or empty, or of another category.
    """
    require_choice("category", category, CATEGORIES)
    splits = {"seen": seen_objects, "unseen": unseen_objects, "novel": novel_objects}
    if selection in splits:
        return splits[selection](category)
    if (of := selection.removesuffix(FOR_TESTS)) in ("unseen", "novel"):
        choose = unseen_objects if of == "unseen" else novel_objects
        return choose(category, 2 * UNSEEN_COUNT)[UNSEEN_COUNT:]
    if match := re.fullmatch(r"(n?)(\d{1,6}):\1(\d{1,6})", selection):
        numbers = range(int(match[2]), int(match[3]))
        ids = tuple(object_id(category, number, novel=bool(match[1])) for number in numbers)
    else:
        ids = () if ":" in selection else tuple(name.strip() for name in selection.split(",") if name.strip())
    if not ids or not all(_is_of(category, name) for name in ids):
        raise ConfigurationError(
            f"Wrong selection of objects for category {category!r}.",
            got=repr(selection),
            allowed="seen | unseen | novel | unseen_test | novel_test | FIRST:END | nFIRST:nEND | id,id,... "
            "(numbers below 10^6)",
            hint="0:4",
        )
    return ids


def _is_of(category: str, name: str) -> bool:
    try:
        return parse_object_id(name)[0] == category
    except ConfigurationError:
        return False


def select_objects(
    category: str,
    selection: str,
    assets: str | os.PathLike[str] | None = None,
    placement_problem: PlacementCheck | None = None,
) -> tuple[str, ...]:
    """Returns the ids of generated objects, or of external assets in the folder ``assets``; see `AssetSource`.

    Raises:
        ConfigurationError: the selection is wrong, or has an object twice.
    """
    if assets is None:
        chosen = parse_object_selection(category, selection)
    else:
        from lerobot_adamanip.assets import AssetSource

        chosen = AssetSource(Path(assets), placement_problem).select(category, selection)
    if len(set(chosen)) < len(chosen):
        once = ",".join(dict.fromkeys(chosen))
        raise ConfigurationError("An object is selected twice.", got=repr(selection), allowed="each once", hint=once)
    return chosen


def get_object(identifier: str, assets: str | os.PathLike[str] | None = None) -> ArticulatedObject:
    """Makes a generated object, or loads an external asset of the folder ``assets``, by id."""
    if assets is None:
        return make_object(identifier)
    from lerobot_adamanip.assets import AssetSource

    return AssetSource(Path(assets)).load(identifier)


def category_of(identifier: str) -> str:
    """Returns ``safe`` for ``safe_007`` and for ``safe:sa1``; the id's form is not checked."""
    return identifier.partition(":")[0] if is_asset_id(identifier) else identifier.rpartition("_")[0]


__all__ = [
    "SEEN_COUNTS", "UNSEEN_COUNT", "ObjectSplit", "category_of", "get_object", "is_asset_id",
    "make_object", "novel_objects", "object_id", "object_split", "parse_object_id", "parse_object_selection",
    "seen_objects", "select_objects", "unseen_objects",
]  # fmt: skip
