"""A URDF with its joints at rest: where each link is, and what of it is seen and touched."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.annotation.file import Annotation, JointChoice
from lerobot_adamanip.assets.meshes import Surface, surfaces
from lerobot_adamanip.assets.urdf import Urdf, UrdfJoint, broken
from lerobot_adamanip.objects.base import Pose
from lerobot_adamanip.rotations import rotation_about, transform

Array = NDArray[np.float64]

FRONT_TO_X: Array = np.diag([-1.0, -1.0, 1.0])
"""AdaManip's and PartNet-Mobility's objects face -x of the URDF's root frame, z up."""


@dataclass(frozen=True)
class Posed:
    """A URDF with its joints at rest, in metres.

    Attributes:
        urdf: the description.
        poses: (4, 4) of each link in the URDF's root frame.
        visuals, collisions: surfaces of each link in the URDF's root frame.
    """

    urdf: Urdf
    poses: Mapping[str, Pose]
    visuals: Mapping[str, tuple[Surface, ...]]
    collisions: Mapping[str, tuple[Surface, ...]]

    def bounds(self, links: set[str] | None = None) -> tuple[Array, Array]:
        """Returns the corners (3,), (3,) of the box around what is seen of the links (all if None)."""
        points = [s.vertices for name, found in self.visuals.items() if links is None or name in links for s in found]
        if not points:
            raise broken(self.urdf.path, "has nothing to be seen.", got="no visual shapes", allowed="a visual mesh")
        every = np.concatenate(points)
        return every.min(axis=0), every.max(axis=0)


def posed(urdf: Urdf, annotation: Annotation) -> Posed:
    """Reads all meshes, and puts every link where it is at rest."""
    rest = {choice.joint: choice.rest for choice in annotation.joints.values()}
    poses = link_poses(urdf, rest, annotation.scale)
    folder, scale = urdf.path.parent, annotation.scale

    def placed(name: str, seen: bool) -> tuple[Surface, ...]:
        link, to_root = urdf.links[name], poses[name]
        elements = link.visuals if seen else link.collisions
        return tuple(
            Surface(s.vertices * scale @ to_root[:3, :3].T + to_root[:3, 3], s.faces, s.color)
            for element in elements
            for s in surfaces(folder, element)
        )

    visuals, solids = ({name: placed(name, seen) for name in urdf.links} for seen in (True, False))
    # A link may be described by one of the two alone.
    return Posed(
        urdf,
        poses,
        {name: visuals[name] or solids[name] for name in urdf.links},
        {name: solids[name] or visuals[name] for name in urdf.links},
    )


def link_poses(urdf: Urdf, positions: Mapping[str, float], scale: float = 1.0) -> dict[str, Pose]:
    """Returns the pose (4, 4) of each link in the root's frame [m].

    Args:
        urdf: the description.
        positions: of joints, in the URDF's units; the others are at rest.
        scale: metres per unit of length of the URDF.
    """
    poses: dict[str, Pose] = {urdf.root: np.eye(4)}
    waiting = list(urdf.joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in poses]
        for joint in ready:
            fixed = joint.pose.copy()
            fixed[:3, 3] *= scale
            moved = joint_motion(joint, positions.get(joint.name, _at_rest(joint)), scale)
            poses[joint.child] = poses[joint.parent] @ fixed @ moved
        waiting = [joint for joint in waiting if joint not in ready]
    return poses


def joint_motion(joint: UrdfJoint, position: float, scale: float) -> Pose:
    """Returns the (4, 4) motion of a joint at ``position`` in its own frame [m]."""
    if joint.kind in ("revolute", "continuous"):
        return transform(rotation=rotation_about(joint.axis, position))
    if joint.kind == "prismatic":
        return transform(np.asarray(joint.axis) * position * scale)
    return np.eye(4)


def _at_rest(joint: UrdfJoint) -> float:
    return 0.0 if joint.limits is None else float(np.clip(0.0, *joint.limits))


def groups(urdf: Urdf, joints: Mapping[str, JointChoice]) -> dict[str, str]:
    """Returns, per link, the link it is rigidly part of: the root, or the child of a joint that plays a role."""
    roles = {choice.joint for choice in joints.values()}
    leaders: dict[str, str] = {}

    def leader(link: str) -> str:
        if link not in leaders:
            above = urdf.joint_above(link)
            leaders[link] = link if above is None or above.name in roles else leader(above.parent)
        return leaders[link]

    return {link: leader(link) for link in urdf.links}


def object_frame(found: Posed, annotation: Annotation) -> Pose:
    """Returns the object frame (4, 4) in the URDF's root frame [m]: on the floor, under the middle of its front.

    The front is that of what does not move, where there is such: a handle that sticks out is not it.
    """
    if annotation.object_in_urdf is not None:
        return annotation.object_in_urdf
    lower, upper = found.bounds()
    leaders = groups(found.urdf, annotation.joints)
    still = {name for name, leader in leaders.items() if leader == found.urdf.root}
    front = lower[0]
    if any(found.visuals[name] for name in still):
        front = found.bounds(still)[0][0]
    return transform((front, (lower[1] + upper[1]) / 2, lower[2]), FRONT_TO_X)
