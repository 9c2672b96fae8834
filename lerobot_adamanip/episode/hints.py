"""Hints: instructions that say what is hidden, in a share of episodes (``--env.hints=SHARE``)."""

from __future__ import annotations

from collections.abc import Mapping

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.seeds import Stream, episode_generator

LEFT: Mapping[str, int] = {
    "bottle": 1, "pen": 1, "pressure_cooker": 1, "coffee_maker": 1, "lamp": 1, "safe": -1, "window": -1, "door": -1,
}  # fmt: skip
"""Category -> sign of a left turn: counterclockwise from above, or from the front of a vertical surface."""


HINTED = frozenset({"locked", "direction", "mode"})
"""Hidden values that a hint names."""


def instruction(category: str, hidden: Mapping[str, bool | int | float], seed: int, share: float) -> str:
    """Returns the instruction of an episode: the category's, in a share of seeds with a hint.

    Args:
        category: category of the object.
        hidden: hidden state of the episode.
        seed: seed of its scene.
        share: share of seeds with a hint, 0 ... 1; each seed has its own number, so a larger share keeps the hints of a
            smaller one.
    """
    plain = CATEGORIES[category].instruction
    if share <= 0 or episode_generator(seed, Stream.HINT, category).random() >= share:
        return plain
    return " ".join((plain, *_sentences(category, hidden)))


def _sentences(category: str, hidden: Mapping[str, bool | int | float]) -> list[str]:
    direction = hidden.get("direction", {1: 1, 2: -1}.get(int(hidden.get("mode", 0))))
    said = []
    if "locked" in hidden:
        said.append("It is locked." if hidden["locked"] else "It is not locked.")
    if "mode" in hidden and direction is None:
        said.append("Push it.")
    elif direction is not None and hidden.get("locked", True):
        said.append(f"It turns {'left' if direction == LEFT.get(category, 1) else 'right'}.")
    return said
