"""Scene of the annotation tool in viser: an object with moving joints, and a gripper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.contract.rotations import quaternion_from_matrix, transform
from lerobot_adamanip.objects.base import ArticulatedObject, Motion, Pose

HAND = (
    # Centre (tool frame: z approach, y closing), full extents and grey value of a Panda hand with open fingers.
    ((0.0, 0.0, -0.080), (0.064, 0.204, 0.066), 205),
    ((0.0, 0.047, -0.021), (0.021, 0.014, 0.054), 70),
    ((0.0, -0.047, -0.021), (0.021, 0.014, 0.054), 70),
)
"""Boxes of the gripper [m]: body, fingers."""


class ObjectView:
    """An external asset in the scene under ``/object``, in the world frame. All its shapes are meshes."""

    def __init__(self, server: Any, obj: ArticulatedObject) -> None:
        self.obj = obj
        self._root = server.scene.add_frame("/object", show_axes=False)
        self._frames: dict[str | None, Any] = {None: self._root}
        for link in obj.links:
            path = f"{self._frames[link.parent].name}/{link.name}"
            self._frames[link.name] = server.scene.add_frame(path, show_axes=False)
            for number, shape in enumerate(shape for shape in link.shapes if shape.visible):
                # The material's colour is linear, the screen's is sRGB.
                color = tuple(int(255 * np.clip(c, 0.0, 1.0) ** (1 / 2.2)) for c in shape.material.color)
                look = {"color": color, "flat_shading": True, "side": "double"}
                server.scene.add_mesh_simple(f"{path}/shape_{number}", shape.vertices, shape.faces, **look)
        self.move({})

    def move(self, positions: Mapping[str, float]) -> None:
        """Moves the joints [rad or m]. Unnamed joints move to zero."""
        for link in self.obj.links:
            if (joint := link.joint) is not None:
                motion = Motion(joint.name, joint.kind, np.asarray(joint.origin), np.asarray(joint.axis))
                place(self._frames[link.name], motion.applied(transform(joint.origin), positions.get(joint.name, 0.0)))

    def remove(self) -> None:
        """Removes the object from the scene."""
        self._root.remove()


def add_gripper(server: Any, name: str) -> Any:
    """Adds a gripper and returns the handle of its frame, the tool frame."""
    frame = server.scene.add_frame(name, show_axes=False)
    for number, (position, extents, grey) in enumerate(HAND):
        server.scene.add_box(f"{name}/{number}", (grey, grey, grey), extents, position=position, opacity=0.75)
    return frame


def place(handle: Any, pose: Pose) -> None:
    """Moves an element of the scene to a pose (4, 4)."""
    handle.position, handle.wxyz = pose[:3, 3], quaternion_from_matrix(pose[:3, :3])
