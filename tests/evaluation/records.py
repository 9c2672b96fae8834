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
    """A successful episode, but for ``changes``: fields, hidden values or of the provenance.

    ``blocked_pulls``, ``wrong_turns`` and ``key_moved`` are numbers of tries.
    """
    object_id = changes.get("object_id", "safe_000")
    hidden = dict(HIDDEN.get(category_of(object_id), {"direction": 1, "turn_range": 1.0}))
    hidden.update({name: changes.pop(name) for name in list(changes) if name in (*hidden, "locked", "direction")})
    made = {item.name: changes.pop(item.name) for item in dataclasses.fields(MADE) if item.name in changes}
    pulls, turns, moved = (changes.pop(name, 0) for name in ("blocked_pulls", "wrong_turns", "key_moved"))
    tries = ((0, 1, True),) * pulls + ((1, 1, True),) * turns + ((1, -1, False),) * moved + ((0, 1, False),)
    values: dict[str, Any] = {
        "seed": 1,
        "given_seed": changes.get("seed", 1),
        "split": split_of(changes.get("seed", 1)),
        "object_id": object_id,
        "object_split": object_split(object_id),
        "hidden_state": hidden,
        "success": True,
        "key_frames": 12,
        "max_key_frames": 45,
        "clipped_goals": 0,
        "max_failed_tries": None,
        "poses": "randomized",
        "try_sequence": tries,
        "joints": {"door": 0.5, "knob": 0.0},
        "provenance": dataclasses.replace(MADE, **made),
    }
    return EpisodeRecord(**{**values, **changes})
