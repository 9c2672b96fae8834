"""The microwave: lock and switch contact; a button releases the door."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lerobot_adamanip.mechanisms.arrays import filled
from lerobot_adamanip.mechanisms.base import (
    Command,
    JointLimits,
    Mechanism,
    Overrides,
    Reading,
    check_names,
    check_positive,
)
from lerobot_adamanip.mechanisms.lock import LockState
from lerobot_adamanip.mechanisms.switch_contact import SwitchContact

if TYPE_CHECKING:  # importing torch takes seconds, and who collects does not draw
    import torch


@dataclass(frozen=True)
class MicrowaveMechanismConfig:
    """Draws and thresholds of the microwave (paper code, section "microwave").

    Attributes:
        p_locked: probability that an episode starts locked.
        release_fraction: of the button's travel, at which the lock gives.
    """

    p_locked: float = 0.5
    release_fraction: float = 0.7


class MicrowaveMechanism(Mechanism[LockState]):
    """Joints ``door`` (0 shut ... ``door_upper``) and ``button`` (0 out ... ``button_travel`` in).

    Args:
        door_upper: opening limit [rad].
        button_travel: of the button [m].
        success: door angle beyond which the microwave is open [rad].
        config: draws and thresholds.
    """

    joints = ("door", "button")

    def __init__(
        self,
        door_upper: float,
        button_travel: float,
        success: float,
        config: MicrowaveMechanismConfig = MicrowaveMechanismConfig(),
    ) -> None:
        self.config, self.goals = config, {"door": success}
        self._travel = check_positive("button_travel", button_travel)
        self._lock = SwitchContact(door_upper, config.p_locked, config.release_fraction)

    def draw(self, batch_size: int, generator: torch.Generator, overrides: Overrides | None = None) -> LockState:
        """Draws ``locked``, which can be overridden."""
        check_names(overrides, ("locked",))
        return self._lock.draw(batch_size, generator, overrides)

    def step(self, state: LockState, reading: Reading) -> tuple[LockState, Command]:
        """The button alone releases the door; it moves whether the door is locked or not."""
        travel = filled(reading["button"], self._travel)
        following, door = self._lock.step_with(state, reading["button"], travel, reading["door"])
        return following, {"door": door, "button": JointLimits(filled(travel, 0.0), travel)}

    def hidden(self, state: LockState, index: int) -> dict[str, Any]:
        """Returns ``locked`` of one environment, as drawn."""
        return {"locked": bool(state.locked[index])}

    def rules(self) -> dict[str, str]:
        """Returns hidden state, draws and thresholds in words."""
        return {
            "hidden": "locked or not",
            "draws": f"locked with p = {self.config.p_locked:g}",
            "thresholds": f"button at {self.config.release_fraction:g} of its travel frees door",
        }
