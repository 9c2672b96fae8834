"""AdaManip's and UniDoorManip's annotations: one point per part, and AdaManip's constants for its grasp."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.annotation.file import (
    ANNOTATION_NAME,
    Annotation,
    JointChoice,
    PartChoice,
    read_annotation,
)
from lerobot_adamanip.assets.checked_xml import HUGE, annotate_hint, broken
from lerobot_adamanip.assets.roles import ROLES, JointRole, PartRole
from lerobot_adamanip.assets.urdf import Urdf, UrdfJoint
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.objects.base import TWO_FINGERS, Pose, any_roll, facing, from_above
from lerobot_adamanip.util.errors import ConfigurationError, require_choice
from lerobot_adamanip.util.json_fields import read

MAX_POINT_BYTES = 1_000_000
PART_FROM_OBJECT: NDArray[np.float64] = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Rotation from our object frame to AdaManip's part frames: y up, z out of the front."""
_DEFAULT_FINAL, _DEFAULT_KEY = "joint_1", "joint_2"


def find_annotation(urdf: Urdf, category: str) -> Annotation:
    """Returns an object's annotation: from ``adamanip.json``, otherwise from AdaManip's or UniDoorManip's points.

    Raises:
        ConfigurationError: there is no annotation, or it is broken.
    """
    path = urdf.path.parent / ANNOTATION_NAME
    return read_annotation(path, category) if path.is_file() else upstream_annotation(urdf, category)


def upstream_annotation(urdf: Urdf, category: str) -> Annotation:
    """Returns the annotation in AdaManip's or UniDoorManip's files: a point per part, in the frame of its link.

    Joints are ``joint_1`` (final) and ``joint_2`` (key), otherwise the first two moving ones. The approach to the point
    is AdaManip's constant for the category.
    """
    roles = ROLES[require_choice("category", category, ROLES)]
    joints = guessed_joints(urdf, category)
    parts = {}
    for part in roles.parts:
        path = next((p for name in part.point_files if (p := urdf.path.parent / name).is_file()), None)
        if path is None:
            raise ConfigurationError(
                f"{urdf.path.parent.name} does not say where its {part.name} is held.",
                got=f"neither {ANNOTATION_NAME} nor {' nor '.join(part.point_files)} in {urdf.path.parent}",
                allowed=f"{ANNOTATION_NAME}, or AdaManip's annotated points (PartNet-Mobility has none)",
                hint=annotate_hint(urdf.path, category),
            )
        link = part_link(urdf, part, joints, roles.final)
        rolls = any_roll() if part.round else TWO_FINGERS
        parts[part.name] = PartChoice(link, upstream_grasp(part, read_point(path)), "link", rolls)
    return Annotation(category, joints, parts)


def guessed_joints(urdf: Urdf, category: str) -> dict[str, JointChoice]:
    """Returns the joints for the category's roles, by AdaManip's names or by their order.

    Raises:
        ConfigurationError: fewer than two joints move, or one has the wrong type.
    """
    roles, moving = ROLES[category], {joint.name: joint for joint in urdf.moving}
    if {_DEFAULT_FINAL, _DEFAULT_KEY} <= set(moving):
        chosen = [moving[_DEFAULT_FINAL], moving[_DEFAULT_KEY]]
    else:
        chosen = list(urdf.leading)[:2]
    if len(chosen) < 2:
        needed = " and ".join(f"{r.name} ({r.kind})" for r in roles.joints)
        raise broken(urdf.path, f"a {category} needs two joints that move.", list(moving) or "none", needed)
    for role, joint in zip(roles.joints, chosen, strict=True):
        check_kind(urdf, category, role, joint)
    return {role.name: default_choice(role, joint) for role, joint in zip(roles.joints, chosen, strict=True)}


def check_kind(urdf: Urdf, category: str, role: JointRole, joint: UrdfJoint) -> None:
    """Raises `ConfigurationError` if a joint does not have the type of its role."""
    kind = "revolute" if joint.kind == "continuous" else joint.kind
    if kind != role.kind:
        what, hint = f"joint {joint.name!r} cannot be the {role.name}.", annotate_hint(urdf.path, category)
        raise broken(urdf.path, what, joint.kind, role.kind, hint=hint)


def default_choice(role: JointRole, joint: UrdfJoint) -> JointChoice:
    """Returns a joint's default range: from zero, or the nearest limit, to the limit on the longer side."""
    lower, upper = joint.limits or (0.0, role.upper)
    if upper - lower < 1e-6:
        lower, upper = 0.0, role.upper
    rest = float(np.clip(0.0, lower, upper))
    return JointChoice(joint.name, rest, upper if upper - rest >= rest - lower else lower)


def part_link(urdf: Urdf, part: PartRole, joints: Mapping[str, JointChoice], final: JointRole) -> str:
    """Returns the link of a part: the child of its last joint, or a handle with its own joint on that link."""
    children = {joint.name: joint.child for joint in urdf.joints}
    link = children[joints[part.joints[-1]].joint]
    if part.joints == (final.name,) and part.name == "handle":
        taken = {choice.joint for choice in joints.values()}
        own = [joint.child for joint in urdf.moving if joint.parent == link and joint.name not in taken]
        return own[0] if own else link
    return link


def upstream_grasp(part: PartRole, point: NDArray[np.float64]) -> Pose:
    """Returns the (4, 4) grasp in AdaManip's part frame at an annotated ``point`` (3,) [m]."""
    held = {"facing": facing, "from_above": from_above}[part.grasp]((0.0, 0.0, 0.0), part.roll)
    rotation = PART_FROM_OBJECT @ held[:3, :3]
    up = PART_FROM_OBJECT @ np.array([0.0, 0.0, part.up])
    return transform(point + part.past * rotation[:, 2] + up, rotation)


def read_point(path: Path) -> NDArray[np.float64]:
    """Reads a point (3,): ``goal_pos`` in JSON, numpy's .npy, or a tensor with that name saved by torch.

    Raises:
        ConfigurationError: the file is anything else, for instance a pickle; nothing is unpickled.
    """
    if path.stat().st_size > MAX_POINT_BYTES:
        raise broken(path, "too large for a point.", f"{path.stat().st_size} bytes", "3 numbers")
    try:
        value = np.asarray(_stored_point(path), dtype=np.float64).reshape(-1)
    except Exception as error:
        got = f"{type(error).__name__}: {error}"[:300]
        raise broken(path, "holds no point that is safe to read.", got, "a tensor or an array of 3 numbers") from error
    if value.shape != (3,) or not np.isfinite(value).all() or np.abs(value).max() > HUGE:
        raise broken(path, "not a point.", value[:6], "3 finite numbers [m]")
    return value


def _stored_point(path: Path) -> Any:
    if path.suffix == ".json":
        return read(path, MAX_POINT_BYTES)["goal_pos"]
    with path.open("rb") as stream:
        if stream.read(6) == b"\x93NUMPY":
            return np.load(path, allow_pickle=False)
    import torch

    value = torch.load(path, map_location="cpu", weights_only=True)
    if not isinstance(value, torch.Tensor):
        raise TypeError(f"{type(value).__name__} instead of a tensor")
    return value.detach().double().numpy()
