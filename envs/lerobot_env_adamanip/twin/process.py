"""Options and mailboxes of the twin's process, free of the simulator."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.hardware.arm_process.encoding import message
from lerobot_adamanip.objects.base import Motion, PartAnnotation

TWIN = "lerobot_env_adamanip.sim.twin.backend:serve_twin"
FRONT_FRAMES = "front"
"""Mailbox of the front camera's `Frame`s."""
SUCCESS_BOX = "success"
"""Mailbox of a boolean: whether the episode's task is done."""
for each in (EnvironmentOptions, Workspace, PartAnnotation, Motion):
    message(each)


@message
@dataclass(frozen=True)
class TwinOptions:
    """Options of the twin's process.

    Attributes:
        environment: the scenes.
        seed: of the first episode.
        image_size: side of colour and depth [px].
        depth_source: ``render``, or ``raycast``, where colours are missing.
        lockstep: whether time passes by steps alone; else ticks follow the clock of the machine.
    """

    environment: EnvironmentOptions
    seed: int = 0
    image_size: int = 256
    depth_source: str = "render"
    lockstep: bool = False


def frame_capacity(size: int) -> int:
    """Returns the bytes of a mailbox for square frames of so many pixels along a side: 3 of colour, 2 of depth each."""
    return 5 * size * size + 1024
