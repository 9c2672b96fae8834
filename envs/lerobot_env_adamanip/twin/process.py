"""Options and mailboxes of the twin process. Does not import the simulator."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.hardware.arm_process.mailbox import message
from lerobot_adamanip.objects.base import Motion, PartAnnotation

TWIN = "lerobot_env_adamanip.sim.twin:serve_twin"
SUCCESS_BOX = "success"
"""Mailbox of a boolean: whether the task is done. Each camera has a mailbox of its name with its `Frame`s."""
for kind in (EnvironmentOptions, Workspace, PartAnnotation, Motion):
    message(kind)


@message
@dataclass(frozen=True)
class TwinOptions:
    """Options of the twin process.

    Attributes:
        environment: options of the scenes.
        seed: seed of the first episode.
        image_source: of colour and depth, see `lerobot_adamanip.episode.options.IMAGE_SOURCES`.
        lockstep: whether only steps advance time; else ticks follow the machine's clock.
    """

    environment: EnvironmentOptions
    seed: int = 0
    image_source: str = "render"
    lockstep: bool = False


def frame_capacity(size: int) -> int:
    """Returns the size of a mailbox for square frames [bytes]. A pixel has 3 bytes of colour and 2 of depth."""
    return 5 * size * size + 1024
