"""Initial annotation for manual refinement (the paper's appendix, "Pose Annotation").

Joints are chosen by their type, their position in the tree and the size of their links. Grasps follow from the bounding
box of the part's mesh.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.annotation.file import Annotation, PartChoice
from lerobot_adamanip.assets.checked_xml import broken
from lerobot_adamanip.assets.kinematics import Posed, groups, object_frame, posed
from lerobot_adamanip.assets.meshes import Surface
from lerobot_adamanip.assets.roles import ROLES, JointRole, PartRole
from lerobot_adamanip.assets.upstream import default_choice, part_link
from lerobot_adamanip.assets.urdf import Urdf, UrdfJoint
from lerobot_adamanip.objects.base import TWO_FINGERS, Pose, any_roll, facing, from_above

Array = NDArray[np.float64]

SMALLEST_PART = 0.02
"""Meshes with a smaller longest side are marks or screws, not handles [m]."""
GRIP_DEPTH = 0.015
"""Maximum depth of a proposed grasp over a part [m]."""


def propose(urdf: Urdf, category: str) -> Annotation:
    """Returns a complete annotation, derived only from the URDF and its meshes.

    Raises:
        ConfigurationError: no two joints fit the category, or a mesh cannot be read.
    """
    roles = ROLES[category]
    by_hand = Annotation(category, {}, {})
    at_rest = posed(urdf, by_hand)
    final = _largest(at_rest, roles.final, urdf.leading)
    others = [joint for joint in urdf.leading if joint is not final]
    below = [joint for joint in others if joint.kind in _kinds(roles.key) and joint.child in urdf.below(final.child)]
    key = _largest(at_rest, roles.key, below or others)
    joints = {role.name: default_choice(role, joint) for role, joint in zip(roles.joints, (final, key), strict=True)}
    scale = _scale(urdf, at_rest, category)
    annotation = Annotation(category, joints, {}, scale)
    at_rest = posed(urdf, annotation)
    frame = object_frame(at_rest, annotation)
    parts = {part.name: propose_part(at_rest, annotation, part, frame) for part in roles.parts}
    return Annotation(category, joints, parts, scale, frame)


def propose_part(
    at_rest: Posed, annotation: Annotation, part: PartRole, frame: Pose, link: str | None = None
) -> PartChoice:
    """Returns the grasp of a part from the bounding box of its mesh.

    Args:
        at_rest: the URDF at rest.
        annotation: its category and joints are used.
        part: part to propose a grasp for.
        frame: (4, 4) object frame in the URDF's root frame [m].
        link: link of the part; None for the child of its last joint.
    """
    roles, joints = ROLES[annotation.category], annotation.joints
    link = link or part_link(at_rest.urdf, part, joints, roles.final)
    leaders = groups(at_rest.urdf, joints)
    surfaces = [s for name, leader in leaders.items() if leader == leaders[link] for s in at_rest.visuals[name]]
    if at_rest.visuals[link] and link != leaders[link]:
        surfaces = list(at_rest.visuals[link])  # a handle with its own link
    to_object: Array = np.linalg.inv(frame).astype(np.float64)
    boxes = [_box(surface, to_object) for surface in surfaces]
    at = (to_object @ at_rest.poses[link])[:3, 3]
    lower, upper = _graspable(boxes, part) if boxes else (at, at)
    rolls = any_roll() if part.round else TWO_FINGERS
    return PartChoice(link, grasp_of_box(lower, upper, part), "object", rolls)


def grasp_of_box(lower: Array, upper: Array, part: PartRole) -> Pose:
    """Returns a grasp (4, 4) over the near face of a box from (3,) to (3,), with fingers across its slimmer side."""
    middle, extent = (lower + upper) / 2, upper - lower
    if part.grasp == "facing":
        depth = min(GRIP_DEPTH, extent[0] / 2)
        return facing((upper[0] - depth, middle[1], middle[2]), 0.0 if extent[1] <= extent[2] else np.pi / 2)
    depth = min(GRIP_DEPTH, extent[2] / 2)
    return from_above((middle[0], middle[1], upper[2] - depth), 0.0 if extent[1] <= extent[0] else np.pi / 2)


def _graspable(boxes: Sequence[tuple[Array, Array]], part: PartRole) -> tuple[Array, Array]:
    """Returns the box of the small mesh nearest to the hand; the box of all meshes if none is small."""
    lower, upper = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
    along = 0 if part.grasp == "facing" else 2
    small = [
        (low, high)
        for low, high in boxes
        if np.prod(high - low + 1e-6) < 0.5 * np.prod(upper - lower + 1e-6) and np.max(high - low) > SMALLEST_PART
    ]
    return max(small, key=lambda box: float(box[1][along]), default=(lower, upper))


def _box(surface: Surface, to_object: Array) -> tuple[Array, Array]:
    points = surface.vertices @ to_object[:3, :3].T + to_object[:3, 3]
    return points.min(axis=0), points.max(axis=0)


def _kinds(role: JointRole) -> tuple[str, ...]:
    return ("revolute", "continuous") if role.kind == "revolute" else (role.kind,)


def _largest(at_rest: Posed, role: JointRole, joints: Sequence[UrdfJoint]) -> UrdfJoint:
    """Returns the joint of the role's type that moves the largest links; prefers joints with limits."""
    fitting = [joint for joint in joints if joint.kind in _kinds(role)]
    if not fitting:
        got = [f"{joint.name} ({joint.kind})" for joint in joints] or "none"
        raise broken(at_rest.urdf.path, f"no joint can be the {role.name}.", got, role.kind, hint="another category")

    def moves(joint: UrdfJoint) -> float:
        links = at_rest.urdf.below(joint.child)
        points = [surface.vertices for name in links for surface in at_rest.visuals[name]]
        return float(np.linalg.norm(np.ptp(np.concatenate(points), axis=0))) if points else 0.0

    return max(fitting, key=moves)


def _scale(urdf: Urdf, at_rest: Posed, category: str) -> float:
    """Returns 1 for URDFs in metres; scales PartNet-Mobility's normalised objects to the category's typical size."""
    if not (urdf.path.parent / "semantics.txt").is_file() and not (urdf.path.parent / "meta.json").is_file():
        return 1.0
    lower, upper = at_rest.bounds()
    return round(ROLES[category].typical_size / float(np.max(upper - lower)), 4)
