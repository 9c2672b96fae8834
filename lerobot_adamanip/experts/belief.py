"""Knowledge of an expert: part poses, and all tries so far in the episode, its own and others'.

A belief stores only the tries and their measured results. Hidden state has few possible values (a direction, a mode,
locked or not). A failed try rules some of them out until something else has changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from lerobot_adamanip.contract.keyframes import KeyFrameLabels
from lerobot_adamanip.objects import PartAnnotation

Parts = Mapping[str, PartAnnotation]
Positions = Mapping[str, float]
Hidden = Mapping[str, bool | int | float]
"""Hidden state, name -> value, as `Mechanism.hidden` returns it."""


@dataclass(frozen=True)
class Knowledge:
    """Initial knowledge of an adaptive expert. A policy could learn all of it from demonstrations.

    Attributes:
        parts: annotated part poses, robot base frame, joints at zero.
        direction: direction of the key, if all episodes of the category share it; None if it is drawn per episode.
    """

    parts: Parts
    direction: int | None = None


@dataclass(frozen=True)
class FeltTry:
    """One try and its measured result: the sign of the commanded motion, and joint positions [rad or m].

    ``failed`` means that the joint did not follow, see `KeyFrameLabels`; ``stalled`` that the hand did not arrive.
    """

    joint: str
    sign: int
    before: Positions
    after: Positions
    failed: bool
    stalled: bool = False


@dataclass(frozen=True)
class Belief:
    """Knowledge of an episode's hidden state: all tries so far, in order; empty at the start."""

    tries: tuple[FeltTry, ...] = ()

    def after(
        self, labels: KeyFrameLabels, joints: tuple[str, ...], before: Positions, after: Positions, *, stalled: bool
    ) -> Belief:
        """Returns the belief after a key frame that moved joints from ``before`` to ``after`` [rad or m].

        ``joints`` are the names of the mechanism's joints; ``labels.tried`` is an index into them.
        """
        if labels.tried < 0:
            return self
        felt = FeltTry(joints[labels.tried], labels.direction, dict(before), dict(after), labels.failed, stalled)
        return replace(self, tries=(*self.tries, felt))

    def latest(self, joint: str) -> FeltTry | None:
        """Returns the latest try of a joint; None if there was none."""
        return next((each for each in reversed(self.tries) if each.joint == joint), None)

    def blocked(self, joint: str, *, until: str = "") -> bool:
        """Returns whether the latest try of a joint failed and no later try of ``until`` succeeded."""
        for each in reversed(self.tries):
            if each.joint == joint:
                return each.failed
            if each.joint == until and not each.failed:
                return False
        return False

    def blocked_ways(self, joint: str, rest: float) -> set[int]:
        """Returns the signs in which a joint was blocked within ``rest`` [rad or m] of zero, and has never moved."""
        blocked = {each.sign for each in self.tries if each.joint == joint and each.failed and at_rest(each, rest)}
        return blocked - self._ways(joint, rest)

    def way(self, joint: str, rest: float) -> int:
        """Returns the sign of a joint's free direction: it moved there, or the other one is blocked; 0 if unknown."""
        ways = self._ways(joint, rest)
        blocked = self.blocked_ways(joint, rest)
        if len(ways) == 1:
            return next(iter(ways))
        return -next(iter(blocked)) if len(blocked) == 1 else 0

    def farthest(self, joint: str) -> float:
        """Returns the largest absolute position that tries of a joint have reached [rad or m]."""
        return max((abs(each.after[joint]) for each in self.tries if each.joint == joint), default=0.0)

    def stopped(self, joint: str, rest: float) -> bool:
        """Returns whether a joint is at its stop: it has moved, and the latest try to send it farther stalled."""
        latest = self.latest(joint)
        if latest is None:
            return False
        before, after = (latest.sign * place[joint] for place in (latest.before, latest.after))
        return before > rest if latest.failed else latest.stalled and after > rest

    def blocked_at(self, joint: str, key: str) -> float:
        """Returns the largest absolute position of ``key`` at which a try of ``joint`` failed; -1 for none."""
        return max((abs(each.before[key]) for each in self.tries if each.joint == joint and each.failed), default=-1.0)

    def _ways(self, joint: str, rest: float) -> set[int]:
        moved = (each.after[joint] for each in self.tries if each.joint == joint)
        return {int(np.sign(place)) for place in moved if abs(place) > rest}


def at_rest(felt: FeltTry, rest: float) -> bool:
    """Returns whether a try began with its joint at rest."""
    return abs(felt.before[felt.joint]) < rest
