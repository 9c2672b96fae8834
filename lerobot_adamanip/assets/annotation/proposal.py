"""A first guess at an annotation, for a person to refine (the paper's appendix, "Pose Annotation").

Joints are guessed from their kind, their place in the tree and the size of what they move; a part's pose from the
bounding box of its mesh.
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
"""What is smaller along each side is a mark or a screw, nothing to hold [m]."""
GRIP_DEPTH = 0.015
"""How far a proposed grasp reaches over a part, at most [m]."""


def propose(urdf: Urdf, category: str) -> Annotation:
    """Returns a whole annotation, guessed from the URDF and its meshes alone.

    Raises:
        ConfigurationError: no two joints move as the category needs, or a mesh cannot be read.
    """
    roles = ROLES[category]
    by_hand = Annotation(category, {}, {})
    found = posed(urdf, by_hand)
    final = _largest(found, roles.final, urdf.leading)
    others = [joint for joint in urdf.leading if joint is not final]
    below = [joint for joint in others if joint.kind in _kinds(roles.key) and final.child in _chain(urdf, joint.child)]
    key = _largest(found, roles.key, below or others)
    joints = {role.name: default_choice(role, joint) for role, joint in zip(roles.joints, (final, key), strict=True)}
    scale = _scale(urdf, found, category)
    annotation = Annotation(category, joints, {}, scale)
    found = posed(urdf, annotation)
    frame = object_frame(found, annotation)
    parts = {part.name: propose_part(found, annotation, part, frame) for part in roles.parts}
    return Annotation(category, joints, parts, scale, frame)


def propose_part(
    found: Posed, annotation: Annotation, part: PartRole, frame: Pose, link: str | None = None
) -> PartChoice:
    """Returns a part's pose by the bounding box of its mesh; ``frame`` (4, 4) is the object's in the URDF's root frame.

    Args:
        found: the URDF at rest.
        annotation: its category and joints.
        part: to propose.
        frame: see above.
        link: that the part belongs to; None: the one its last joint moves.
    """
    roles, joints = ROLES[annotation.category], annotation.joints
    link = link or part_link(found.urdf, part, joints, roles.final, roles.key)
    leaders = groups(found.urdf, joints)
    surfaces = [s for name, leader in leaders.items() if leader == leaders[link] for s in found.visuals[name]]
    if found.visuals[link] and link != leaders[link]:
        surfaces = list(found.visuals[link])  # a handle that is a link of its own
    to_object: Array = np.linalg.inv(frame).astype(np.float64)
    boxes = [_box(surface, to_object) for surface in surfaces]
    at = (to_object @ found.poses[link])[:3, 3]
    lower, upper = _graspable(boxes, part) if boxes else (at, at)
    rolls = any_roll() if part.round else TWO_FINGERS
    return PartChoice(link, grasp_of_box(lower, upper, part), "object", rolls)


def grasp_of_box(lower: Array, upper: Array, part: PartRole) -> Pose:
    """Returns a grasp (4, 4) over the near face of a box, (3,) to (3,), fingers across its slimmer side."""
    middle, extent = (lower + upper) / 2, upper - lower
    if part.grasp == "facing":
        depth = min(GRIP_DEPTH, extent[0] / 2)
        return facing((upper[0] - depth, middle[1], middle[2]), 0.0 if extent[1] <= extent[2] else np.pi / 2)
    depth = min(GRIP_DEPTH, extent[2] / 2)
    return from_above((middle[0], middle[1], upper[2] - depth), 0.0 if extent[1] <= extent[0] else np.pi / 2)


def _graspable(boxes: Sequence[tuple[Array, Array]], part: PartRole) -> tuple[Array, Array]:
    """The box of the mesh that sticks out furthest towards the hand, if it is one among larger ones; else of all."""
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


def _largest(found: Posed, role: JointRole, joints: Sequence[UrdfJoint]) -> UrdfJoint:
    """The joint of the role's kind that moves the most; one with a limit rather than one that turns for ever."""
    fitting = [joint for joint in joints if joint.kind in _kinds(role)]
    if not fitting:
        got = [f"{joint.name} ({joint.kind})" for joint in joints] or "none"
        raise broken(found.urdf.path, f"no joint can be the {role.name}.", got, role.kind, hint="another category")

    def moves(joint: UrdfJoint) -> float:
        moved = [name for name in found.urdf.links if joint.child in _chain(found.urdf, name)]
        points = [surface.vertices for name in moved for surface in found.visuals[name]]
        return float(np.linalg.norm(np.ptp(np.concatenate(points), axis=0))) if points else 0.0

    return max(fitting, key=moves)


def _chain(urdf: Urdf, link: str) -> list[str]:
    """The link and all above it."""
    chain = [link]
    while (above := urdf.joint_above(chain[-1])) is not None:
        chain.append(above.parent)
    return chain


def _scale(urdf: Urdf, found: Posed, category: str) -> float:
    """1 for metres; for PartNet-Mobility, whose objects are all of one size, what makes a typical one of it."""
    if not (urdf.path.parent / "semantics.txt").is_file() and not (urdf.path.parent / "meta.json").is_file():
        return 1.0
    lower, upper = found.bounds()
    return round(ROLES[category].typical_size / float(np.max(upper - lower)), 4)
