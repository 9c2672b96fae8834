"""How far apart in time a picture and a state are that stand in one row."""

from __future__ import annotations

from dataclasses import dataclass

MAX_SKEW = 0.05
"""A picture and a state further apart than this are not of one moment [s]: 5 mm at the arm's 0.1 m/s."""


@dataclass
class SkewWatch:
    """Counts the ticks of one camera whose picture is not of the state's moment; it stops nothing.

    Attributes:
        ticks: counted.
        skewed: of them, those with more than `MAX_SKEW`.
        worst: largest skew so far [s].
    """

    ticks: int = 0
    skewed: int = 0
    worst: float = 0.0

    def count(self, frame_stamp: float, state_stamp: float) -> bool:
        """Counts a tick by the stamps of its frame and its state [s, same clock]; returns whether they go together."""
        skew = abs(frame_stamp - state_stamp)
        self.ticks += 1
        self.skewed += skew > MAX_SKEW
        self.worst = max(self.worst, skew)
        return skew <= MAX_SKEW

    def told(self) -> str:
        """The count in words."""
        share = f"{self.skewed} of {self.ticks} ticks"
        return f"{share} skewed by more than {1e3 * MAX_SKEW:.0f} ms, at worst {1e3 * self.worst:.0f} ms"
