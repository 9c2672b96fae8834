"""Records of episodes that nobody ran."""

from __future__ import annotations

import dataclasses
from typing import Any

from lerobot_adamanip.catalog import category_of, object_split
from lerobot_adamanip.contract.seeds import split_of
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.evaluation.record import EpisodeRecord, Provenance

MADE = Provenance(SIMULATION_VERSION, "0.3.0", "paper", "run", None, 0, {"torch": "2.11.0"})
HIDDEN: dict[str, dict[str, Any]] = {
    "safe": {"locked": False, "direction": 1, "knob_range": 1.2},
    "microwave": {"locked": False},
    "lamp": {"mode": 0},
}


def record(**changes: Any) -> EpisodeRecord:
    """A successful episode, but for ``changes``: fields, hidden values or of the provenance."""
    object_id = changes.get("object_id", "safe_000")
    hidden = dict(HIDDEN.get(category_of(object_id), {"direction": 1, "turn_range": 1.0}))
    hidden.update({name: changes.pop(name) for name in list(changes) if name in (*hidden, "locked", "direction")})
    made = {item.name: changes.pop(item.name) for item in dataclasses.fields(MADE) if item.name in changes}
    failed = changes.get("blocked_pulls", 0) + changes.get("wrong_turns", 0)
    values: dict[str, Any] = {
        "seed": 1,
        "given_seed": changes.get("seed", 1),
        "split": split_of(changes.get("seed", 1)),
        "object_id": object_id,
        "object_split": object_split(object_id),
        "hidden_state": hidden,
        "success": True,
        "key_frames": 12,
        "tries": failed + 1,
        "blocked_pulls": 0,
        "wrong_turns": 0,
        "key_moved": False,
        "first_part": "handle",
        "first_try_failed": failed > 0,
        "try_sequence": ((0, 1, True),) * failed + ((0, 1, False),) * (changes.get("tries", failed + 1) - failed),
        "joints": {"door": 0.5, "knob": 0.0},
        "provenance": dataclasses.replace(MADE, **made),
    }
    return EpisodeRecord(**{**values, **changes})
