"""Conversion of an object's data to a SAPIEN articulation."""

from __future__ import annotations

import functools
import hashlib
import os
import stat
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import sapien
from mani_skill.utils.structs import Articulation
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import quaternion_from_matrix, rotation_with_x_along
from lerobot_adamanip.objects import ArticulatedObject, Joint, Shape
from lerobot_adamanip.util.files import write_atomically
from lerobot_env_adamanip.sim.simulation import named_joints

FRICTION = 1.2
"""Friction of objects; the gripper's pads have 2.0, and PhysX uses the mean of a pair."""
NO_SELF_COLLISION = 1 << 27
"""Bit of SAPIEN's third collision group: shapes that share it do not collide. Set for an object's links and plinth.

Links of a generated object are close but never touch, and contacts between them would only cost time. Meshes of an
external asset often overlap a little and must not jam."""


def sapien_pose(matrix: NDArray[Any]) -> sapien.Pose:
    """Converts a (4, 4) matrix to sapien.Pose."""
    return sapien.Pose(p=matrix[:3, 3], q=quaternion_from_matrix(matrix[:3, :3]))


def build_object(scene: Any, obj: ArticulatedObject, pose: NDArray[Any]) -> Articulation:
    """Builds ``obj`` as a fixed-base articulation with its root at ``pose`` (4, 4), world frame."""
    builder = scene.create_articulation_builder()
    builder.initial_pose = sapien_pose(pose)
    links: dict[str, Any] = {}
    material = sapien.physx.PhysxMaterial(FRICTION, FRICTION, 0.0)
    for link in obj.links:
        built = builder.create_link_builder(links.get(link.parent) if link.parent else None)
        built.set_name(link.name)
        built.collision_groups = [1, 1, NO_SELF_COLLISION, 0]
        for shape in link.shapes:
            if shape.visible and scene.can_render():
                add_visual(built, shape)
            if shape.collides:
                _add(built, "collision", "convex_collision_from_file", shape, material)
        built.set_mass_and_inertia(link.mass, *_inertia(link.mass, link.shapes))
        if link.joint is not None:
            _set_joint(built, link.joint)
        links[link.name] = built
    articulation = builder.build(name=obj.object_id, fix_root_link=True)
    _set_springs(articulation, obj)
    for body in articulation._objs[0].links if obj.weightless else ():
        body.disable_gravity = True
    return articulation


def _set_springs(articulation: Articulation, obj: ArticulatedObject) -> None:
    """Sets springs as drives towards their rest positions; keeps the joints' damping."""
    names = [link.joint.name for link in obj.links if link.joint is not None]
    for name, active in named_joints(articulation._objs[0], names).items():
        joint = obj.joint(name)
        if joint.kind == "revolute" and joint.stiffness:
            # SAPIEN's builder sets the friction of joints to 0.05, at which a return spring stops before its rest.
            active.set_friction(0.0)
        if joint.stiffness:
            active.set_drive_properties(joint.stiffness, joint.damping)
            active.set_drive_target(joint.rest)


def _set_joint(link: Any, joint: Joint) -> None:
    """Sets a joint. SAPIEN's joints move about the x axis of their frames, so both frames get x along the axis."""
    link.set_joint_name(joint.name)
    align = rotation_with_x_along(joint.axis)
    in_parent = np.eye(4)
    in_parent[:3, :3], in_parent[:3, 3] = align, joint.origin
    in_child = np.eye(4)
    in_child[:3, :3] = align
    link.set_joint_properties(
        joint.kind, [list(joint.limits)], sapien_pose(in_parent), sapien_pose(in_child), 0.0, joint.damping
    )


def _inertia(mass: float, shapes: tuple[Shape, ...]) -> tuple[sapien.Pose, list[float]]:
    """Returns centre of mass and principal inertia of the box around a link's shapes: approximate, never singular."""
    solid = [shape.pose_in_link[:3, 3] for shape in shapes if shape.collides]
    centers = np.stack(solid or [np.zeros(3)])
    lower, upper = centers.min(0) - 0.02, centers.max(0) + 0.02
    for shape in shapes:
        if shape.collides and shape.vertices is not None:
            corners = shape.vertices @ shape.pose_in_link[:3, :3].T + shape.pose_in_link[:3, 3]
            lower, upper = np.minimum(lower, corners.min(0)), np.maximum(upper, corners.max(0))
    a, b, c = upper - lower
    return sapien.Pose((lower + upper) / 2), [
        mass / 12 * (b * b + c * c),
        mass / 12 * (a * a + c * c),
        mass / 12 * (a * a + b * b),
    ]


def add_visual(link: Any, shape: Shape) -> None:
    """Adds the look of ``shape`` to a builder's link or actor; fails if nothing can render."""
    material = sapien.render.RenderMaterial()
    material.set_base_color([*shape.material.color, 1.0])
    material.set_roughness(shape.material.roughness)
    material.set_metallic(shape.material.metallic)
    _add(link, "visual", "visual_from_file", shape, material)


def _add(link: Any, what: str, of_mesh: str, shape: Shape, material: Any) -> None:
    pose = sapien_pose(shape.pose_in_link)
    if shape.vertices is not None:
        getattr(link, f"add_{of_mesh}")(str(mesh_file(shape)), pose=pose, material=material)
    else:  # half extents of a box; radius and half length of a cylinder or capsule
        size = (list(shape.size),) if shape.kind == "box" else shape.size
        getattr(link, f"add_{shape.kind}_{what}")(pose, *size, material)


# Mesh files for SAPIEN, named by a content hash, in the system's temporary folder -----------------------------------


def mesh_file(shape: Shape) -> Path:
    """Returns a file with a mesh shape's triangles, flat shaded: each face has its own vertices and normals."""
    assert shape.vertices is not None
    assert shape.faces is not None
    digest = hashlib.sha256(shape.vertices.tobytes() + shape.faces.tobytes()).hexdigest()[:24]
    path = cache_folder() / f"{digest}.obj"
    if not path.is_file():
        import trimesh

        corners = shape.vertices[shape.faces].reshape(-1, 3)
        flat = trimesh.Trimesh(corners, np.arange(shape.faces.size).reshape(-1, 3), process=False)
        content = str(flat.export(file_type="obj", include_normals=True)).rstrip().encode() + b"\n"
        write_atomically(path, content)
    return path


@functools.cache
def cache_folder() -> Path:
    """Returns this user's mesh folder in the system's temporary folder; creates a new one if others can write to it."""
    folder = Path(tempfile.gettempdir()) / f"adamanip_meshes_{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if not is_private(folder):
        return Path(tempfile.mkdtemp(prefix="adamanip_meshes_"))
    return folder


def is_private(folder: Path) -> bool:
    """Returns whether a folder is not a link, belongs to this user, and is not writable for others."""
    status = folder.lstat()
    is_writable = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not is_writable
