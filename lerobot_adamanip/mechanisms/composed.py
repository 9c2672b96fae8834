"""Locks in a row, and a lock that shuts again: mechanisms on the joints that the objects have."""

from __future__ import annotations

from dataclasses import dataclass, replace

from lerobot_adamanip.mechanisms.base import (
    SHUT,
    Draws,
    Limits,
    Mechanism,
    Overrides,
    Positions,
    check_positive,
    draw_direction,
    draw_flag,
    draw_range,
    overridden,
    range_words,
    turn_limits,
)
from lerobot_adamanip.mechanisms.families import TURN_RELEASE

NOTCH = {"revolute": 0.15, "prismatic": 0.010}
"""Position at which a lock holds the part that opens [rad, m]: between a part that is blocked and one that is open."""
NOTCH_SHARE = 0.9
"""Share of it at which the part counts as pulled."""
BACK = 0.3
"""Share of its range below which a key counts as turned back; hands turn a part back with an error of some degrees."""
PLAY = {"revolute": 0.01, "prismatic": 5e-4}
"""Motion of a part whose lock shuts again [rad, m]: half of what `episode.tries` counts as motion, so the try fails."""
KEPT_OUT = 0.5
"""Share of its range above which a lock keeps a key turned; below, at rest."""


@dataclass(frozen=True)
class RowState:
    """The hidden draw; ``freed``: number of locks freed so far; ``kept``: angle at which a lock keeps the key [rad]."""

    direction: int
    turn_range: float
    second_pulls: bool
    third_pulls: bool
    freed: int = 0
    kept: float = 0.0

    @property
    def pulls(self) -> tuple[bool, bool, bool]:
        """Whether each lock is freed by a pull (and not by the key), in order."""
        return False, self.second_pulls, self.third_pulls


class RowMechanism(Mechanism[RowState]):
    """Three locks in a row. Each motion is free only when the locks before it are.

    The first lock is freed by turning the key, in a hidden direction. Each of the others is freed by one of two
    motions: moving the key to its other end (back to rest, or out again), or pulling the part that opens by a notch.
    The motion that is not the next one is blocked: the key is kept where it stands, or the part is. A pull that no
    turn follows goes on to the end, so with ``second_pulls`` and ``third_pulls`` the part opens after one turn.

    Args:
        key: joint that turns.
        final: joint that opens, 0 shut.
        key_range: the object's nominal range [rad].
        fractions: the episode's range is uniform between these shares of it.
        final_upper: limit of the final joint [rad or m].
        notch: position at which the second lock holds the final joint [rad or m].
        success: position of the final joint beyond which the object is open [rad or m].
    """

    hidden_names = ("direction", "turn_range", "second_pulls", "third_pulls")

    def __init__(
        self,
        key: str,
        final: str,
        *,
        key_range: float,
        fractions: tuple[float, float],
        final_upper: float,
        notch: float,
        success: float,
    ) -> None:
        self.key, self.final = key, final
        self.joints, self.goals = (final, key), {final: success}
        self._key_range, self._fractions = check_positive("key_range", key_range), fractions
        self._final_upper, self._notch = check_positive("final_upper", final_upper), notch

    def _draw(self, generator: Draws, overrides: Overrides) -> RowState:
        direction = draw_direction(generator, 0.5, overrides)
        turn_range = draw_range(generator, self._key_range, self._fractions, overrides, "turn_range")
        second = draw_flag(generator, overrides, "second_pulls")
        return RowState(direction, turn_range, second, draw_flag(generator, overrides, "third_pulls"))

    def step(self, state: RowState, positions: Positions) -> tuple[RowState, dict[str, Limits]]:
        """Frees the next locks whose motion is done."""
        turned = min(max(state.direction * positions[self.key], 0.0), state.turn_range)
        while state.freed < len(state.pulls) and self._is_done(state, turned, positions[self.final]):
            state = replace(state, freed=state.freed + 1, kept=turned)
        state = replace(state, kept=self._kept(state, turned))
        low, high = 0.0, state.turn_range
        if not self._turns_next(state):
            low, high = (state.kept, high) if self._is_out(state) else (low, state.kept)
        key = (low, high) if state.direction > 0 else (-high, -low)
        return state, {self.key: key, self.final: (0.0, self._reach(state))}

    def _is_done(self, state: RowState, turned: float, pulled: float) -> bool:
        if state.pulls[state.freed]:
            return pulled >= NOTCH_SHARE * self._notch
        is_outward = state.pulls[: state.freed].count(False) % 2 == 0
        share = turned / state.turn_range
        return share >= TURN_RELEASE if is_outward else share <= BACK

    def _turns_next(self, state: RowState) -> bool:
        return not all(state.pulls[state.freed : state.freed + 1])

    def _kept(self, state: RowState, turned: float) -> float:
        if self._turns_next(state):
            return turned
        return max(state.kept, turned) if self._is_out(state) else min(state.kept, turned)

    def _is_out(self, state: RowState) -> bool:
        return state.kept > KEPT_OUT * state.turn_range

    def _reach(self, state: RowState) -> float:
        """Returns how far the final joint may move before the key has to move again [rad or m]."""
        turns = [number for number in range(state.freed, len(state.pulls)) if not state.pulls[number]]
        if not turns:
            return self._final_upper
        return self._notch if any(state.pulls[: turns[0]]) else 0.0

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "direction, range, motions of the second and third lock",
            "draws": f"direction +/- with p = 0.5; range {range_words(self._fractions)}; "
            f"second and third lock: {self.key} or pull with p = 0.5",
            "thresholds": f"{self.key} out at {TURN_RELEASE:g} and back at {BACK:g} of its range, "
            f"{self.final} at {self._notch:g}",
        }


@dataclass(frozen=True)
class ChangingState:
    """The hidden draw, and the lock's state.

    Attributes:
        direction, later_direction: direction of the key, first and after the lock has shut again.
        turn_range: range of the key [rad or m].
        relocks: whether the lock shuts again at the first pull.
        is_free: whether the final joint can open.
        has_relocked: whether the lock has shut again.
        is_back: whether the key has been back since then: a key that is still turned does not count.
    """

    direction: int
    turn_range: float
    relocks: bool
    later_direction: int
    is_free: bool = False
    has_relocked: bool = False
    is_back: bool = True

    @property
    def present_direction(self) -> int:
        """Direction in which the key moves now."""
        return self.later_direction if self.has_relocked else self.direction


class ChangingMechanism(Mechanism[ChangingState]):
    """A lock that may shut again at the first pull; its key then moves in a direction that is drawn anew.

    The part gives way by ``play`` at that pull, and no farther: the try fails. It happens once.

    Args:
        key, final, key_range, fractions, final_upper, success: see `RowMechanism`; a range [rad or m].
        release: share of the range at which the final joint is free.
        play: motion of the final joint at the failed pull [rad or m].
        has_directions: whether the key moves both ways; a button does not.
    """

    def __init__(
        self,
        key: str,
        final: str,
        *,
        key_range: float,
        fractions: tuple[float, float],
        release: float,
        final_upper: float,
        play: float,
        success: float,
        has_directions: bool = True,
    ) -> None:
        self.key, self.final = key, final
        self.joints, self.goals = (final, key), {final: success}
        turned = ("direction", "turn_range", "relocks", "later_direction")
        self.hidden_names = turned if has_directions else ("relocks",)
        self._key_range, self._fractions = check_positive("key_range", key_range), fractions
        self._release, self._final_upper, self._play = release, check_positive("final_upper", final_upper), play
        self._p_positive = 0.5 if has_directions else 1.0

    def _draw(self, generator: Draws, overrides: Overrides) -> ChangingState:
        direction = draw_direction(generator, self._p_positive, overrides)
        turn_range = draw_range(generator, self._key_range, self._fractions, overrides, "turn_range")
        relocks = draw_flag(generator, overrides, "relocks")
        later = 1 if generator.random() < self._p_positive else -1
        return ChangingState(direction, turn_range, relocks, overridden(later, overrides, "later_direction", (-1, 1)))

    def step(self, state: ChangingState, positions: Positions) -> tuple[ChangingState, dict[str, Limits]]:
        """Frees the final joint once the key is moved far enough; shuts it again at the first pull if it relocks."""
        pulled, present = max(0.0, positions[self.final]), positions[self.key]
        sticks = state.relocks and not state.has_relocked
        if state.is_free and sticks and pulled >= 0.5 * self._play:
            state, sticks = replace(state, is_free=False, has_relocked=True, is_back=False), False
        turned = state.present_direction * present
        state = replace(state, is_back=state.is_back or turned <= BACK * state.turn_range)
        is_free = state.is_free or (state.is_back and turned >= self._release * state.turn_range)
        state = replace(state, is_free=is_free)
        low, high = turn_limits(state.present_direction, state.turn_range)
        reach = self._play if sticks else self._final_upper
        final = (0.0, reach if is_free else min(pulled, self._play)) if is_free or state.has_relocked else SHUT
        # A key that stands on the other side may turn back.
        return state, {self.key: (min(low, present), max(high, present)), self.final: final}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        turns = len(self.hidden_names) > 1
        directions = f"directions +/- with p = 0.5; range {range_words(self._fractions)}; " if turns else ""
        return {
            "hidden": "whether it shuts again" + (", direction before and after, range" if turns else ""),
            "draws": f"{directions}shuts again with p = 0.5",
            "thresholds": f"{self.key} at {self._release:g} of its range frees {self.final}",
        }
