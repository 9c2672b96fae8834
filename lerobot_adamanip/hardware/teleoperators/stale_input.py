"""Devices that keep their last value when they fall silent: a deflection that nobody confirms any more is rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lerobot_adamanip.util.errors import RobotError

REST_AFTER_S = 0.2
"""A deflection that was not reported anew for so long counts as rest."""
LOST_AFTER_S = 1.0
"""After so long the device counts as lost."""


class SilenceWatch:
    """Tells whether a device still reports, by a value that changes with each report.

    Args:
        device: its name, for the error.
        clock: returns seconds.
    """

    def __init__(self, device: str, clock: Callable[[], float]) -> None:
        self._device, self._clock = device, clock
        self._report: Any = None
        self._heard = float("-inf")

    def is_silent(self, report: Any, *, driving: bool) -> bool:
        """Returns whether the device, which ought to report while it drives, has not done so for `REST_AFTER_S`.

        Args:
            report: whatever differs between two reports, e.g. a time stamp.
            driving: whether the last report asks for a motion: a device at rest may be silent for ever.

        Raises:
            RobotError: it has been silent for `LOST_AFTER_S` while it drove.
        """
        now = self._clock()
        if report != self._report or not driving:
            self._report, self._heard = report, now
        silent = now - self._heard
        if silent > LOST_AFTER_S:
            raise RobotError(
                f"The {self._device} does not report any more, and its last report asks for a motion.",
                got=f"no report for {silent:.1f} s",
                allowed=f"{LOST_AFTER_S:g} s",
                hint="see to its cable, battery or connection, and start the command again",
            )
        return silent > REST_AFTER_S
