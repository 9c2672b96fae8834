"""Checks of the fields of a benchmark's declaration."""

from __future__ import annotations

from collections.abc import Mapping

from lerobot_adamanip.benchmark.paper_rates import SUCCESS
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.datasets.collection_spec import LIMITS
from lerobot_adamanip.episode.options import IMAGE_SIZES, POSES
from lerobot_adamanip.experts import EXPERT_KINDS, EXPERT_STRATEGIES
from lerobot_adamanip.mechanisms import MECHANISM_RULES
from lerobot_adamanip.util.json_fields import Check, choice, flag, integer, listing, mapping, number, table, text

OBJECT_SPLITS = ("seen", "unseen", "novel")
NAME = text(r"[a-z][a-z0-9_]{0,39}", "a name of small letters, digits and _")
TITLE = text(r"[^\r\n|*`<>]{1,80}", "a line of plain text")
_COUNT = integer(1, 10**8)
_CATEGORIES, _SPLITS = (listing(choice(tuple(names)), 1, len(names)) for names in (CATEGORIES, OBJECT_SPLITS))
_OPTIONS = listing(text(r"--[a-z][\w.]*=[^\r\n`]{0,400}", "an option --NAME=VALUE"), 0, 60)
_ANYTHING = mapping(NAME, lambda _, value: value, 60)
DECLARATION = table(
    {
        "reference": NAME,
        "scales": mapping(NAME, _ANYTHING, 20),
        "demonstrations": mapping(NAME, _ANYTHING, 60),
        "methods": mapping(NAME, _ANYTHING, 200),
        "trials": _ANYTHING,
    }
)
SCALE: Mapping[str, Check] = {
    "objects": text(r"[\w:,]{1,400}", "objects, as `adamanip collect --objects` takes them"),
    **dict.fromkeys(("demonstrations", "steps", "batch_size", "save_every", "episodes", "environments"), _COUNT),
    "device": text(r"[a-z]{1,10}(:\d{1,2})?", "a device of torch"),
    "poses": choice(("", *POSES)),
    "evaluate": _OPTIONS,
    "categories": _CATEGORIES,
    "splits": _SPLITS,
    "seeds": listing(integer(0, 2**31 - 1), 1, 100),
    "note": text(r"[^\r\n|*`<>]{0,300}", "a line of plain text"),
    "beside_paper": flag,
}
DEMONSTRATIONS: Mapping[str, Check] = {
    "expert": choice(EXPERT_KINDS),
    "expert_strategy": choice(EXPERT_STRATEGIES),
    "trials": integer(*LIMITS["trials"]),
    "late_starts": number(0, 1),
    "num_points": integer(1, 16_384),
    "image_size": integer(0, IMAGE_SIZES[1]),
    "poses": choice(POSES),
    "mechanism_rules": choice(tuple(MECHANISM_RULES)),
}
METHOD: Mapping[str, Check] = {
    "title": TITLE,
    "policy": NAME,
    "options": listing(text(r"--policy\.[a-z][\w.]*=[^\r\n`]{0,400}", "an option --policy.NAME=VALUE"), 0, 60),
    "demonstrations": text(r"|[a-z][a-z0-9_]{0,39}", "a set of demonstrations, or nothing"),
    "rounds": listing(_ANYTHING, 0, 20),
    "train": _OPTIONS,
    "evaluate": _OPTIONS,
    "steps": mapping(NAME, _COUNT, 20),
    "train_at": mapping(NAME, _OPTIONS, 20),
    "paper": choice(("", *SUCCESS)),
}
ROUND: Mapping[str, Check] = {"corrections": _COUNT, "steps": _COUNT, "start": choice(("new", "trained"))}
TRIALS = table(
    {
        "method": NAME,
        "numbers": listing(integer(0, LIMITS["trials"][1]), 1, 30),
        "none": NAME,
        "categories": _CATEGORIES,
        "splits": _SPLITS,
        "scales": listing(NAME, 1, 20),
    }
)
