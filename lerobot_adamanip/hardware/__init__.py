"""A real Franka, its twin, depth cameras and teleoperators, as devices of LeRobot; drivers load on first use."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["ON_CREATION"]
ON_CREATION: list[Callable[[], object]] = []
"""Called when a robot is created. LeRobot's recorder opens its dataset later, so the plugin can patch it here."""
