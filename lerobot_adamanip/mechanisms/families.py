"""The paper's five families as four mechanisms. `lerobot_adamanip.mechanisms.table` assigns them to categories."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from lerobot_adamanip.mechanisms.base import (
    SHUT,
    Draws,
    Limits,
    Mechanism,
    Overrides,
    Positions,
    check_positive,
    direction_words,
    draw_direction,
    draw_flag,
    draw_range,
    overridden,
    range_words,
    turn_limits,
)

TURN_RANGE = (0.5, 1.0)
"""An episode's range is uniform between these fractions of the object's (paper code)."""
TURN_RELEASE = 0.85
"""Share of that range at which the final joint is free (paper code)."""


@dataclass(frozen=True)
class TurnToOpenState:
    """The hidden draw, and ``free``: whether the final joint has been released; it stays free."""

    direction: int
    turn_range: float
    free: bool


class TurnToOpenMechanism(Mechanism[TurnToOpenState]):
    """Rotate & Slide, or Lock with Random Rotation Direction: a key joint that turns one way and locks a final joint.

    The key's range is hidden. Once it has turned far enough the final joint is free.

    Args:
        key: joint that turns (``cap``).
        final: joint that opens (``lift``), 0 shut.
        key_range: the object's nominal range [rad].
        final_upper: limit of the final joint [rad or m].
        success: position of the final joint beyond which the object is open [rad or m].
        p_positive: probability that the part turns in its joint's positive direction.
    """

    hidden_names = ("direction", "turn_range")

    def __init__(
        self, key: str, final: str, *, key_range: float, final_upper: float, success: float, p_positive: float = 0.5
    ) -> None:
        self.key, self.final = key, final
        self.joints, self.goals = (final, key), {final: success}
        self._key_range = check_positive("key_range", key_range)
        self._final_upper = check_positive("final_upper", final_upper)
        self._p_positive = p_positive

    def _draw(self, generator: Draws, overrides: Overrides) -> TurnToOpenState:
        direction = draw_direction(generator, self._p_positive, overrides)
        turn_range = draw_range(generator, self._key_range, TURN_RANGE, overrides, "turn_range")
        return TurnToOpenState(direction, turn_range, free=False)

    def step(self, state: TurnToOpenState, positions: Positions) -> tuple[TurnToOpenState, dict[str, Limits]]:
        """Frees the final joint once the key is turned far enough; pulling never does."""
        free = state.free or abs(positions[self.key]) >= TURN_RELEASE * state.turn_range
        final = (0.0, self._final_upper) if free else SHUT
        return replace(state, free=free), {self.key: turn_limits(state.direction, state.turn_range), self.final: final}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "range" if self._p_positive in (0.0, 1.0) else "direction, range",
            "draws": f"{direction_words(self._p_positive)}; range {range_words(TURN_RANGE)}",
            "thresholds": f"{self.key} at {TURN_RELEASE:g} of its range frees {self.final}",
        }


KNOB_RANGE = (0.9, 1.0)
"""An episode's knob range is uniform between these fractions of the object's (paper code)."""
KNOB_RELEASE, SPOIL = 0.85, 0.15
"""Shares of that range at which the door is released, and at which `lock_on_turn` locks it (paper code)."""
AJAR = 0.02
"""A door beyond this angle [rad] is open; its knob cannot lock it."""


@dataclass(frozen=True)
class SafeState:
    """The hidden draw, and ``released``: whether the door can open; it stays released except with `lock_on_turn`."""

    locked: bool
    direction: int
    knob_range: float
    released: bool


class SafeMechanism(Mechanism[SafeState]):
    """Lock, Random Rotation Direction, Switch Contact: a knob that turns one way releases the door.

    Joints ``door`` (0 shut ... ``door_upper``) and ``knob`` (0 at rest; one way only).

    Args:
        door_upper: opening limit [rad].
        knob_range: the object's nominal knob range [rad].
        success: door angle beyond which the safe is open [rad] (paper code: pi/7).
        p_positive: probability that the knob turns clockwise, seen from the front.
        lock_on_turn: upstream's variant, not the paper's. In a safe that was drawn unlocked, turning the knob by more
            than `SPOIL` of its range locks a shut door for the rest of the episode.
    """

    joints = ("door", "knob")
    hidden_names = ("locked", "direction", "knob_range")

    def __init__(
        self,
        door_upper: float,
        knob_range: float,
        success: float = math.pi / 7,
        *,
        p_positive: float = 0.5,
        lock_on_turn: bool = False,
    ) -> None:
        self.goals = {"door": success}
        self._door_upper = check_positive("door_upper", door_upper)
        self._knob_range = check_positive("knob_range", knob_range)
        self._p_positive, self._lock_on_turn = p_positive, lock_on_turn

    def _draw(self, generator: Draws, overrides: Overrides) -> SafeState:
        locked = draw_flag(generator, overrides, "locked")
        direction = draw_direction(generator, self._p_positive, overrides)
        return SafeState(
            locked, direction, draw_range(generator, self._knob_range, KNOB_RANGE, overrides, "knob_range"), not locked
        )

    def step(self, state: SafeState, positions: Positions) -> tuple[SafeState, dict[str, Limits]]:
        """Releases the door once the knob is turned far enough; pulling never does."""
        turned = abs(positions["knob"])
        released = state.released or turned >= KNOB_RELEASE * state.knob_range
        if self._lock_on_turn and not state.locked:
            spoils = turned > SPOIL * state.knob_range and positions["door"] < AJAR
            released = state.released and not spoils
        door = (0.0, self._door_upper) if released else SHUT
        limits = {"door": door, "knob": turn_limits(state.direction, state.knob_range)}
        return replace(state, released=released), limits

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        spoils = f"; turning an unlocked one by {SPOIL:g} locks it" if self._lock_on_turn else ""
        return {
            "hidden": "locked or not, direction, range",
            "draws": f"locked with p = 0.5; {direction_words(self._p_positive)}; range {range_words(KNOB_RANGE)}",
            "thresholds": f"knob at {KNOB_RELEASE:g} of its range frees door{spoils}",
        }


BUTTON_RELEASE = 0.7
"""Share of the button's travel at which the door is released (paper code)."""


@dataclass(frozen=True)
class MicrowaveState:
    """``locked``: the draw. ``released``: whether the door can open; once released, it stays so."""

    locked: bool
    released: bool


class MicrowaveMechanism(Mechanism[MicrowaveState]):
    """Lock, Switch Contact: a button releases the door.

    Joints ``door`` (0 shut ... ``door_upper`` [rad]) and ``button`` (0 out ... ``button_travel`` [m]).
    The microwave is open beyond the door angle ``success`` [rad].
    """

    joints = ("door", "button")
    hidden_names = ("locked",)

    def __init__(self, door_upper: float, button_travel: float, success: float) -> None:
        self.goals = {"door": success}
        self._door_upper = check_positive("door_upper", door_upper)
        self._travel = check_positive("button_travel", button_travel)

    def _draw(self, generator: Draws, overrides: Overrides) -> MicrowaveState:
        locked = draw_flag(generator, overrides, "locked")
        return MicrowaveState(locked, not locked)

    def step(self, state: MicrowaveState, positions: Positions) -> tuple[MicrowaveState, dict[str, Limits]]:
        """Releases the door once the button is pushed. The button moves whether the door is locked or not."""
        released = state.released or abs(positions["button"]) >= BUTTON_RELEASE * self._travel
        door = (0.0, self._door_upper) if released else SHUT
        return MicrowaveState(state.locked, released), {"door": door, "button": (0.0, self._travel)}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "locked or not",
            "draws": "locked with p = 0.5",
            "thresholds": f"button at {BUTTON_RELEASE:g} of its travel frees door",
        }


PUSH, ROTATE_POSITIVE, ROTATE_NEGATIVE = 0, 1, 2
PUSH_SUCCESS, TURN_SUCCESS = 0.01, 0.85
"""Travel of the button [m] and share of the knob's range beyond which the lamp is on (paper code)."""


@dataclass(frozen=True)
class LampState:
    """``mode``: push, rotate positive or rotate negative."""

    mode: int


class LampMechanism(Mechanism[LampState]):
    """Push / Rotate: a part that is a button, or a knob that turns one way; both look the same.

    Joints ``button`` (0 out ... ``push_upper`` in [m]) and ``knob`` (0 at rest, ``turn_upper`` to a side [rad]).
    """

    joints = ("button", "knob")
    hidden_names = ("mode",)

    def __init__(self, push_upper: float, turn_upper: float) -> None:
        self.goals = {"button": PUSH_SUCCESS, "knob": TURN_SUCCESS * turn_upper}
        self._push_upper = check_positive("push_upper", push_upper)
        self._turn_upper = check_positive("turn_upper", turn_upper)

    def _draw(self, generator: Draws, overrides: Overrides) -> LampState:
        mode = min(int(generator.random() * 3), 2)
        return LampState(overridden(mode, overrides, "mode", (PUSH, ROTATE_POSITIVE, ROTATE_NEGATIVE)))

    def step(self, state: LampState, positions: Positions) -> tuple[LampState, dict[str, Limits]]:
        """Frees one of the three motions, by mode, for the whole episode."""
        if state.mode == PUSH:
            return state, {"button": (0.0, self._push_upper), "knob": SHUT}
        direction = 1 if state.mode == ROTATE_POSITIVE else -1
        return state, {"button": SHUT, "knob": turn_limits(direction, self._turn_upper)}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "push, rotate + or rotate -",
            "draws": "one of the three, uniformly",
            "thresholds": "the other two motions are blocked",
        }
