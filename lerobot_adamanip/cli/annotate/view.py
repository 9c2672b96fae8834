"""What the annotation tool shows: an object whose joints move, and a gripper, in viser's scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lerobot_adamanip.contract.rotations import quaternion_from_matrix, rotation_about, transform
from lerobot_adamanip.objects.base import ArticulatedObject, Joint, Link, Material, Pose, Shape

HAND = (
    # Where (tool frame: z approach, y closing), full extents, grey; a Panda's hand with its fingers open.
    ((0.0, 0.0, -0.080), (0.064, 0.204, 0.066), 205),
    ((0.0, 0.047, -0.021), (0.021, 0.014, 0.054), 70),
    ((0.0, -0.047, -0.021), (0.021, 0.014, 0.054), 70),
)
"""Boxes [m]: body, fingers."""


class ObjectView:
    """An object in the scene under ``/object``; its frame is the world's."""

    def __init__(self, server: Any, obj: ArticulatedObject) -> None:
        self._server, self.obj = server, obj
        self._frames: dict[str, Any] = {}
        self._paths: dict[str, str] = {}
        self._root = server.scene.add_frame("/object", show_axes=False)
        for link in obj.links:
            self._add(link)
        self.move({})

    def _add(self, link: Link) -> None:
        path = f"{self._paths[link.parent] if link.parent else '/object'}/{link.name}"
        self._paths[link.name] = path
        self._frames[link.name] = self._server.scene.add_frame(path, show_axes=False)
        for number, shape in enumerate(shape for shape in link.shapes if shape.visible):
            vertices, faces = triangles(shape)
            self._server.scene.add_mesh_simple(
                f"{path}/shape_{number}",
                vertices,
                faces,
                color=screen_color(shape.material),
                flat_shading=True,
                side="double",
            )

    def move(self, positions: Mapping[str, float]) -> None:
        """Moves the joints [rad or m]; those not named go to zero."""
        for link in self.obj.links:
            if link.joint is not None:
                place(self._frames[link.name], joint_pose(link.joint, positions.get(link.joint.name, 0.0)))

    def remove(self) -> None:
        """Takes the object out of the scene."""
        self._root.remove()


def add_gripper(server: Any, name: str) -> Any:
    """Adds a gripper and returns its frame's handle; the frame is the tool's."""
    frame = server.scene.add_frame(name, show_axes=False)
    for number, (position, extents, grey) in enumerate(HAND):
        server.scene.add_box(f"{name}/{number}", (grey, grey, grey), extents, position=position, opacity=0.75)
    return frame


def joint_pose(joint: Joint, position: float) -> Pose:
    """Returns the pose (4, 4) of a joint's link in its parent."""
    if joint.kind == "prismatic":
        axis = np.asarray(joint.axis) / np.linalg.norm(joint.axis)
        return transform(np.asarray(joint.origin) + position * axis)
    return transform(joint.origin, rotation_about(joint.axis, position))


def place(handle: Any, pose: Pose) -> None:
    """Moves something in the scene to a pose (4, 4)."""
    handle.position, handle.wxyz = pose[:3, 3], quaternion_from_matrix(pose[:3, :3])


def screen_color(material: Material) -> tuple[int, int, int]:
    """Returns the sRGB colour of a material's linear one."""
    red, green, blue = (int(255 * np.clip(c, 0.0, 1.0) ** (1 / 2.2)) for c in material.color)
    return red, green, blue


def triangles(shape: Shape) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Returns a shape's surface, (V, 3) in its link's frame and (F, 3)."""
    import trimesh

    if shape.kind == "mesh":
        assert shape.vertices is not None
        assert shape.faces is not None
        vertices, faces = np.asarray(shape.vertices, np.float64), shape.faces
    else:
        # trimesh's cylinders and capsules lie along z, ours along x.
        along_x = rotation_about((0.0, 1.0, 0.0), np.pi / 2)
        if shape.kind == "box":
            mesh, turn = trimesh.creation.box(extents=2 * np.asarray(shape.size)), np.eye(3)
        elif shape.kind == "cylinder":
            radius, half = shape.size
            mesh, turn = trimesh.creation.cylinder(radius=radius, height=2 * half, sections=40), along_x
        else:
            radius, half = shape.size
            ball = np.asarray(trimesh.creation.icosphere(2, radius).vertices)
            ends = np.concatenate([ball + np.array((0, 0, z)) for z in (-half, half)])
            mesh, turn = trimesh.convex.convex_hull(ends), along_x
        vertices, faces = mesh.vertices @ turn.T, mesh.faces
    pose = shape.pose_in_link
    return np.asarray(vertices @ pose[:3, :3].T + pose[:3, 3], np.float32), np.asarray(faces, np.int32)
