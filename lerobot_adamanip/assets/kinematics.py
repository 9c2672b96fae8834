"""A URDF with joints at rest: link poses, and their visual and collision surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.annotation.file import Annotation, JointChoice
from lerobot_adamanip.assets.checked_xml import broken
from lerobot_adamanip.assets.meshes import Surface, surfaces
from lerobot_adamanip.assets.paths import MissingFileError
from lerobot_adamanip.assets.urdf import Geometry, Urdf, UrdfJoint
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.objects.base import Pose

Array = NDArray[np.float64]

FRONT_TO_X: Array = np.diag([-1.0, -1.0, 1.0])
"""Rotation to our x axis: AdaManip's and PartNet-Mobility's objects face -x of the URDF's root frame, z up."""


MAX_HOPS = 20
"""Maximum length of a chain of mimic joints; a longer one is a cycle."""


@dataclass(frozen=True)
class Posed:
    """A URDF with its joints at rest, in metres.

    Attributes:
        urdf: the description.
        poses: (4, 4) of each link in the URDF's root frame.
        visuals, collisions: surfaces of each link in the URDF's root frame.
        missing: link -> referenced meshes that its folder does not contain.
    """

    urdf: Urdf
    poses: Mapping[str, Pose]
    visuals: Mapping[str, tuple[Surface, ...]]
    collisions: Mapping[str, tuple[Surface, ...]]
    missing: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def bounds(self, links: set[str] | None = None) -> tuple[Array, Array]:
        """Returns the corners (3,), (3,) of the box around the visible shapes of the links (all if None)."""
        points = [s.vertices for name, parts in self.visuals.items() if links is None or name in links for s in parts]
        if not points:
            raise broken(self.urdf.path, "has nothing to be seen.", "no visual shapes", "a visual mesh")
        every = np.concatenate(points)
        return every.min(axis=0), every.max(axis=0)


Described = tuple[tuple[Surface, ...], tuple[str, ...]]
"""Surfaces of a link's visual or collision elements, and their missing meshes."""


def _or_else(own: Described, other: Described) -> tuple[Surface, ...]:
    """Returns a link's own surfaces; the other kind's if these are missing, or if only these have a missing mesh."""
    gap_elsewhere_only = bool(own[1]) and bool(other[0]) and not other[1]
    return other[0] if not own[0] or gap_elsewhere_only else own[0]


def posed(urdf: Urdf, annotation: Annotation) -> Posed:
    """Reads all meshes and computes all link poses at rest. Missing meshes are left out."""
    rest = {choice.joint: choice.rest for choice in annotation.joints.values()}
    poses = link_poses(urdf, rest, annotation.scale)
    folder, scale = urdf.path.parent, annotation.scale

    def described(name: str, elements: tuple[Geometry, ...]) -> Described:
        placed: list[Surface] = []
        missing: list[str] = []
        to_root = poses[name]
        for element in elements:
            try:
                placed += [
                    Surface(s.vertices * scale @ to_root[:3, :3].T + to_root[:3, 3], s.faces, s.color)
                    for s in surfaces(folder, element)
                ]
            except MissingFileError:
                missing.append(element.mesh)
        return tuple(placed), tuple(missing)

    seen = {name: described(name, link.visuals) for name, link in urdf.links.items()}
    solid = {name: described(name, link.collisions) for name, link in urdf.links.items()}
    missing = {name: tuple(dict.fromkeys(seen[name][1] + solid[name][1])) for name in urdf.links}
    return Posed(
        urdf,
        poses,
        {name: _or_else(seen[name], solid[name]) for name in urdf.links},
        {name: _or_else(solid[name], seen[name]) for name in urdf.links},
        {name: names for name, names in missing.items() if names},
    )


def link_poses(urdf: Urdf, positions: Mapping[str, float], scale: float = 1.0) -> dict[str, Pose]:
    """Returns the pose (4, 4) of each link in the root's frame [m].

    Args:
        urdf: the description.
        positions: joint positions in the URDF's units; other joints are at rest or follow their leader.
        scale: metres per length unit of the URDF.
    """
    poses: dict[str, Pose] = {urdf.root: np.eye(4)}
    waiting = list(urdf.joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in poses]
        for joint in ready:
            fixed = joint.pose.copy()
            fixed[:3, 3] *= scale
            moved = joint_motion(joint, _position(urdf, joint, positions), scale)
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


def _position(urdf: Urdf, joint: UrdfJoint, positions: Mapping[str, float], hops: int = 0) -> float:
    """Returns a joint's position: given, otherwise from the joint that it follows, otherwise at rest."""
    if joint.name in positions:
        return positions[joint.name]
    leader = next((each for each in urdf.moving if joint.mimic and each.name == joint.mimic.leader), None)
    if joint.mimic is None or leader is None or hops > MAX_HOPS:
        return 0.0 if joint.limits is None else float(np.clip(0.0, *joint.limits))
    return joint.mimic.multiplier * _position(urdf, leader, positions, hops + 1) + joint.mimic.offset


def groups(urdf: Urdf, joints: Mapping[str, JointChoice]) -> dict[str, str]:
    """Returns link -> link that it is rigidly attached to: the root, or the child of a joint with a role."""
    roles = {choice.joint for choice in joints.values()}

    def leader(link: str) -> str:
        while (above := urdf.joint_above(link)) is not None and above.name not in roles:
            link = above.parent
        return link

    return {link: leader(link) for link in urdf.links}


def object_frame(at_rest: Posed, annotation: Annotation) -> Pose:
    """Returns the object frame (4, 4) in the URDF's root frame [m]: on the floor, at the middle of the front.

    The front is that of the static links, if they have shapes; a protruding handle does not count.
    """
    if annotation.object_in_urdf is not None:
        return annotation.object_in_urdf
    lower, upper = at_rest.bounds()
    leaders = groups(at_rest.urdf, annotation.joints)
    still = {name for name, leader in leaders.items() if leader == at_rest.urdf.root}
    front = lower[0]
    if any(at_rest.visuals[name] for name in still):
        front = at_rest.bounds(still)[0][0]
    return transform((front, (lower[1] + upper[1]) / 2, lower[2]), FRONT_TO_X)
