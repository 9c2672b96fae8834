"""Whether an object can be opened at all: every goal of its mechanism within its joints' limits, with a margin."""

from __future__ import annotations

from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_adamanip.objects.base import ArticulatedObject
from lerobot_adamanip.util.errors import ConfigurationError

MARGIN = 1.1
"""A joint has to go this many times as far as its goal: success is being beyond it."""


def infeasible(obj: ArticulatedObject) -> str | None:
    """Returns why an object can never be opened, in words; None if it can.

    Every goal has to be within reach, as the hidden state decides which of them an episode is about (a lamp's).
    """
    try:
        goals = make_mechanism(obj).goals
    except ConfigurationError as error:
        return str(error).splitlines()[0]
    for name, goal in goals.items():
        joint = obj.joint(name)
        far = max(abs(limit) for limit in joint.limits)
        if far < MARGIN * goal:
            unit = "m" if joint.kind == "prismatic" else "rad"
            return f"joint {name} goes {far:.3g} {unit}, its goal is beyond {goal:.3g} {unit}"
    return None
