"""What one episode of ``adaafford`` has told so far: its interactions, and what came of them."""

from __future__ import annotations

from collections import deque

import numpy as np
from torch import Tensor

from lerobot_policy_adamanip.affordance.plans import holds_something
from lerobot_policy_adamanip.common.demonstrations import ContactTracker


class Memory:
    """One episode's interactions: what was done in contact, and what came of it.

    Args:
        length: of them that are kept, the latest.
    """

    def __init__(self, length: int) -> None:
        self.interactions: deque[tuple[Tensor, Tensor, Tensor]] = deque(maxlen=length)
        self.made = 0
        self.sent: tuple[Tensor, Tensor] | None = None
        """Pose before the latest command, and the command (10,) each, until it is felt what came of it."""
        self._tracker = ContactTracker()

    @property
    def opening(self) -> float | None:
        """Opening that the part in contact was approached with; None where the hand is not in contact."""
        return self._tracker.opening

    def feel(self, pose: Tensor) -> None:
        """Takes the pose (10,) that the latest command ended in."""
        if self.sent is None:
            return
        before, command = self.sent
        if self._tracker.sent(*(each.cpu().numpy().astype(np.float32) for each in self.sent)):
            self.interactions.append((before, command, pose))
            self.made += 1
        self.sent = None

    def holds(self, pose: Tensor) -> bool:
        """Whether a hand that feels ``pose`` (10,) is in contact still: a grasp has something between its fingers."""
        return self.opening == 0.0 or (self.opening is not None and holds_something(pose))
