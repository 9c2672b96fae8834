"""What experts know before they touch anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lerobot_adamanip.experts.primitives import Parts

Hidden = Mapping[str, bool | int | float]
"""A hidden state by name, as `Mechanism.hidden` returns it."""


@dataclass(frozen=True)
class Knowledge:
    """What an adaptive expert knows at the start: nothing that a policy could not learn from demonstrations.

    Attributes:
        parts: annotated part poses, robot base frame, joints at zero.
        direction: the one way the key turns in every episode of the category; None where it is drawn per episode.
    """

    parts: Parts
    direction: int | None = None
