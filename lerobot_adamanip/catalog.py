"""Which objects there are: ids, selections of them, and the object an id stands for, generated or external.

``safe_000`` ... ``safe_035`` are seen in demonstrations; higher numbers are unseen.
"""

from __future__ import annotations

import functools
import importlib
import os
import re
from pathlib import Path

from lerobot_adamanip.assets import AssetSource, is_asset_id
from lerobot_adamanip.categories import CATEGORIES
from lerobot_adamanip.errors import ConfigurationError, require_choice
from lerobot_adamanip.objects.base import ArticulatedObject

SEEN_COUNTS = {name: category.seen for name, category in CATEGORIES.items()}
"""Objects per category in the paper (its Table 1)."""


def categories() -> tuple[str, ...]:
    """Returns the names of the categories."""
    return tuple(CATEGORIES)


def object_id(category: str, number: int) -> str:
    """Returns ``safe_007`` for ("safe", 7)."""
    return f"{require_choice('category', category, categories())}_{number:03d}"


def parse_object_id(identifier: str) -> tuple[str, int]:
    """Returns ("safe", 7) for ``safe_007``; raises `ConfigurationError` for anything else."""
    match = re.fullmatch(r"([a-z_]+)_([0-9]{3}|[1-9][0-9]{3,5})", identifier)  # one object, one id
    if match is None or match[1] not in CATEGORIES:
        raise ConfigurationError(
            "Unknown object id.",
            got=repr(identifier),
            allowed=f"<category>_<number>, category one of {', '.join(CATEGORIES)}",
            hint="safe_000",
        )
    return match[1], int(match[2])


@functools.lru_cache(maxsize=64)
def make_object(identifier: str) -> ArticulatedObject:
    """Builds an object by id. Deterministic: one id is one object, everywhere."""
    category, number = parse_object_id(identifier)
    generator = importlib.import_module(f"lerobot_adamanip.objects.{category}")
    made: ArticulatedObject = getattr(generator, f"make_{category}")(number)
    return made


def seen_objects(category: str) -> tuple[str, ...]:
    """Returns the ids of the paper's count of objects, those that demonstrations are collected on."""
    count = SEEN_COUNTS[require_choice("category", category, categories())]
    return tuple(object_id(category, number) for number in range(count))


def unseen_objects(category: str, count: int = 20) -> tuple[str, ...]:
    """Returns the ids of the first ``count`` objects beyond the seen ones."""
    start = SEEN_COUNTS[require_choice("category", category, categories())]
    return tuple(object_id(category, number) for number in range(start, start + count))


def parse_object_selection(category: str, selection: str) -> tuple[str, ...]:
    """Returns object ids for ``seen``, ``unseen``, ``0:4`` (a range of numbers), or ``safe_000,safe_007``."""
    require_choice("category", category, categories())
    if selection == "seen":
        return seen_objects(category)
    if selection == "unseen":
        return unseen_objects(category)
    if match := re.fullmatch(r"(\d+):(\d+)", selection):
        ids = tuple(object_id(category, number) for number in range(int(match[1]), int(match[2])))
    else:
        ids = tuple(name.strip() for name in selection.split(",") if name.strip())
    if not ids or any(parse_object_id(name)[0] != category for name in ids):
        raise ConfigurationError(
            f"Wrong selection of objects for category {category!r}.",
            got=repr(selection),
            allowed="seen | unseen | FIRST:END | id,id,...",
            hint="0:4",
        )
    return ids


def select_objects(category: str, selection: str, assets: str | os.PathLike[str] | None = None) -> tuple[str, ...]:
    """Returns the ids of generated objects, or of those in the folder ``assets``; see `AssetSource.select` there."""
    return (
        parse_object_selection(category, selection)
        if assets is None
        else AssetSource(Path(assets)).select(category, selection)
    )


def get_object(identifier: str, assets: str | os.PathLike[str] | None = None) -> ArticulatedObject:
    """Makes a generated object, or loads one of the folder ``assets``, by id."""
    return make_object(identifier) if assets is None else AssetSource(Path(assets)).load(identifier)


def category_of(identifier: str) -> str:
    """Returns ``safe`` for ``safe_007`` and for ``safe:sa1``; the id's form is not checked."""
    return identifier.partition(":")[0] if is_asset_id(identifier) else identifier.rpartition("_")[0]


__all__ = [
    "SEEN_COUNTS", "categories", "category_of", "get_object", "is_asset_id", "make_object", "object_id",
    "parse_object_id", "parse_object_selection", "seen_objects", "select_objects", "unseen_objects",
]  # fmt: skip
