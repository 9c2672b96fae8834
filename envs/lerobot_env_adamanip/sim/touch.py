"""Touch: which joints of the object the hand has its fingers on."""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien

from lerobot_env_adamanip.sim.mechanism_driver import joint_name

HAND_LINKS = ("hand", "leftfinger", "rightfinger", "leftfinger_pad", "rightfinger_pad")
TOUCH_FORCE = 1.0
"""A contact weaker than this is a brush [N]."""


class HandTouch:
    """Finds what the hand touches.

    Args:
        system: physics of the scene.
        arm: articulation whose `HAND_LINKS` feel.
        target: articulation that is felt.
    """

    def __init__(
        self,
        system: sapien.physx.PhysxCpuSystem,
        arm: sapien.physx.PhysxArticulation,
        target: sapien.physx.PhysxArticulation,
    ) -> None:
        self._system = system
        self._hand = {link.entity for link in arm.links if link.name.endswith(HAND_LINKS)}
        self._carrying = {link.entity: _joints_above(link) for link in target.links}

    def joints(self) -> set[str]:
        """Returns the joints that carry a link which the hand touches now."""
        touched: set[str] = set()
        for contact in self._system.get_contacts():
            first, second = (body.entity for body in contact.bodies)
            link = second if first in self._hand else first if second in self._hand else None
            carrying = self._carrying.get(link, ())
            if carrying and self._force(contact) > TOUCH_FORCE:
                touched.update(carrying)
        return touched

    def _force(self, contact: Any) -> float:
        impulse = sum(float(np.linalg.norm(point.impulse)) for point in contact.points)
        return impulse / float(self._system.timestep)


def _joints_above(link: Any) -> tuple[str, ...]:
    """Names of the joints between a link and its root."""
    names: list[str] = []
    while link is not None:
        if link.joint.dof:
            names.append(joint_name(link.joint))
        link = link.parent
    return tuple(names)
