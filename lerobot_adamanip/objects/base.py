"""Object model: links of simple shapes, joints, and annotated part poses. Pure data, no simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.contract.rotations import rotated_about_line, rotation_about, transform

Pose = NDArray[np.float64]
ShapeKind = Literal["box", "cylinder", "capsule", "mesh"]
JointKind = Literal["fixed", "revolute", "prismatic"]


@dataclass(frozen=True)
class Material:
    """Surface: linear RGB colour in [0, 1], and the parameters of a metallic-roughness shader."""

    color: tuple[float, float, float]
    roughness: float = 0.6
    metallic: float = 0.0

    def darker(self) -> Material:
        """Returns the material with half its brightness, for seams and lines."""
        red, green, blue = self.color
        return replace(self, color=(0.5 * red, 0.5 * green, 0.5 * blue))


@dataclass(frozen=True)
class Shape:
    """A visual and, by default, collision primitive of a link.

    Attributes:
        kind: ``box`` (size = half extents), ``cylinder`` / ``capsule`` (size = radius, half length; the axis is x),
            or ``mesh`` (from ``vertices`` and ``faces``; convex if it collides).
        size: see ``kind`` [m].
        pose_in_link: (4, 4) pose in the link's frame.
        material: look of the surface.
        collides: whether it collides; otherwise it is decoration.
        vertices: (V, 3) [m] for a mesh.
        faces: (F, 3) vertex indices for a mesh.
        visible: whether it is rendered; otherwise it only collides.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose_in_link: Pose
    material: Material
    collides: bool = True
    vertices: NDArray[np.float32] | None = None
    faces: NDArray[np.int32] | None = None
    visible: bool = True


@dataclass(frozen=True)
class Joint:
    """Motion of a link relative to its parent.

    The link's frame has its origin at the joint; at position zero its axes are parallel to the parent's.

    Attributes:
        name, kind: name in mechanisms, and type.
        axis: (3,) unit vector, parent frame.
        origin: (3,) a point on the axis, parent frame [m].
        limits: range of positions [rad or m].
        damping: viscous damping [N m s/rad or N s/m].
        stiffness: spring in the joint [N m/rad or N/m]; 0 for none.
        rest: slack position of the spring [rad or m]; outside the limits, the spring presses the joint against one.
    """

    name: str
    kind: JointKind
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    limits: tuple[float, float] = (0.0, 0.0)
    damping: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0


@dataclass(frozen=True)
class Link:
    """A rigid body: shapes, and a joint to its parent (the root has neither joint nor parent)."""

    name: str
    shapes: tuple[Shape, ...]
    mass: float
    parent: str | None = None
    joint: Joint | None = None


@dataclass(frozen=True)
class Motion:
    """Motion of a held part by one joint.

    Attributes:
        joint, kind: name and type.
        point: (3,) a point on the axis [m]; ignored if prismatic.
        axis: (3,) unit vector; positive positions turn about it by the right-hand rule, or slide along it.
    """

    joint: str
    kind: JointKind
    point: NDArray[np.float64]
    axis: NDArray[np.float64]

    def applied(self, pose: Pose, position: float) -> Pose:
        """Returns ``pose`` (4, 4) after the joint has moved by ``position`` [rad or m]."""
        if self.kind == "revolute":
            return rotated_about_line(pose, self.point, self.axis, position)
        moved = pose.copy()
        moved[:3, 3] += position * self.axis
        return moved

    def followed(self, before: Pose, now: Pose) -> float:
        """Returns the joint's motion [rad or m] between two poses (4, 4) of a hand that kept its grip."""
        if self.kind == "prismatic":
            return float(self.axis @ (now[:3, 3] - before[:3, 3]))
        first, second = before[:3, 3] - self.point, now[:3, 3] - self.point
        if np.linalg.norm(np.cross(self.axis, first)) < ON_AXIS:
            # A hand on the axis does not translate, so its rotation is compared.
            square = before[:3, int(np.argmin(np.abs(self.axis @ before[:3, :3])))]
            first, second = square, now[:3, :3] @ before[:3, :3].T @ square
        along = (self.axis @ first) * (self.axis @ second)
        return float(np.arctan2(self.axis @ np.cross(first, second), first @ second - along))

    def in_frame(self, frame: Pose) -> Motion:
        """Returns this motion in a new frame, given by its pose ``frame`` (4, 4) in the present one."""
        point, axis = frame[:3, :3] @ self.point + frame[:3, 3], frame[:3, :3] @ self.axis
        return replace(self, point=point, axis=axis)


ON_AXIS = 0.02
"""Distance to an axis below which a grasp only rotates [m]."""
TWO_FINGERS = (0.0, np.pi)
"""Equivalent rolls about the approach for a gripper with two equal fingers [rad]."""


def any_roll() -> tuple[float, ...]:
    """Returns the rolls of a grasp on a round part, which is held equally from every side [rad]."""
    return tuple(2 * np.pi * np.arange(8) / 8)


@dataclass(frozen=True)
class PartAnnotation:
    """Annotated pose of a graspable part: the paper's part pose, as a grasp (appendix "Pose Annotation").

    Attributes:
        name: part name, ``handle`` or ``knob``.
        grasp: (4, 4) tool pose of the grasp: z is the approach direction, y the closing direction of the fingers.
        motions: motions of the joints that carry the part, root first. In ``grasp`` all joints are at zero.
        rolls: rotations about the approach with equally good grasps [rad].
    """

    name: str
    grasp: Pose
    motions: tuple[Motion, ...]
    rolls: tuple[float, ...] = TWO_FINGERS

    def moved(self, positions: Mapping[str, float]) -> Pose:
        """Returns the (4, 4) grasp at these joint positions [rad or m]; other joints are at zero."""
        pose = self.grasp
        for motion in reversed(self.motions):
            pose = motion.applied(pose, positions.get(motion.joint, 0.0))
        return pose

    def motion(self, joint: str) -> Motion:
        """Returns the part's motion by a joint; raises KeyError that lists the joints if this one does not carry it."""
        for motion in self.motions:
            if motion.joint == joint:
                return motion
        raise KeyError(f"{self.name} does not move with {joint!r}; with {[motion.joint for motion in self.motions]}")

    def rolled(self, angle: float) -> PartAnnotation:
        """Returns the annotation with the grasp rotated by ``angle`` [rad] about its approach."""
        return replace(self, grasp=self.grasp @ transform(rotation=rotation_about((0.0, 0.0, 1.0), angle)))

    def in_frame(self, frame: Pose) -> PartAnnotation:
        """Returns this annotation in a new frame, given by its pose ``frame`` (4, 4) in the present one."""
        motions = tuple(motion.in_frame(frame) for motion in self.motions)
        return replace(self, grasp=frame @ self.grasp, motions=motions)


@dataclass(frozen=True)
class ArticulatedObject:
    """An object. Its frame: origin on the floor below the middle of the front, x out of the front, z up [m].

    Attributes:
        object_id: ``safe_007``.
        category: ``safe``.
        links: root first, parents before children.
        parts: annotations in the object frame, with joints at zero.
        size: (width, depth, height) [m] of the body without handles; of external assets, of the bounding box.
        description: sampled parameters, for labels and cards.
        weightless: whether its links ignore gravity, as upstream; true for external assets, which have no springs.
    """

    object_id: str
    category: str
    links: tuple[Link, ...]
    parts: tuple[PartAnnotation, ...]
    size: tuple[float, float, float]
    description: str = ""
    weightless: bool = False

    def part(self, name: str) -> PartAnnotation:
        """Returns the annotation of a part; raises KeyError that lists the parts if it does not exist."""
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"{self.object_id} has no part {name!r}; it has {[part.name for part in self.parts]}")

    def joint(self, name: str) -> Joint:
        """Returns a joint by name; raises KeyError that lists the joints if it does not exist."""
        joints = {link.joint.name: link.joint for link in self.links if link.joint is not None}
        if name in joints:
            return joints[name]
        raise KeyError(f"{self.object_id} has no joint {name!r}; it has {list(joints)}")


def annotate(
    links: Sequence[Link], link: str, name: str, grasp: Pose, rolls: tuple[float, ...] = TWO_FINGERS
) -> PartAnnotation:
    """Returns the annotation of a part.

    Args:
        links: links of the object, parents before children.
        link: link of the part; the joints between it and the root carry the part.
        name: name of the part.
        grasp: (4, 4) in the object frame, with joints at zero.
        rolls: see `PartAnnotation`.
    """
    chain, by_name = [], {each.name: each for each in links}
    current: Link | None = by_name[link]
    while current is not None:
        chain.append(current)
        current = by_name[current.parent] if current.parent is not None else None
    motions: list[Motion] = []
    origin: NDArray[np.float64] = np.zeros(3)
    for each in reversed(chain):
        if each.joint is not None:
            origin = origin + each.joint.origin
            if each.joint.kind != "fixed":
                axis = np.asarray(each.joint.axis, dtype=np.float64)
                motions.append(Motion(each.joint.name, each.joint.kind, origin, axis / np.linalg.norm(axis)))
    return PartAnnotation(name, grasp, tuple(motions), rolls)


def from_above(position: ArrayLike, roll: float = 0.0) -> Pose:
    """Returns a grasp at ``position`` that approaches straight down (along -z), fingers closing along the object's y.

    ``roll`` [rad] rotates the fingers about the approach.
    """
    columns = np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    return transform(position, columns @ rotation_about((0.0, 0.0, 1.0), roll))


def facing(position: ArrayLike, roll: float = 0.0) -> Pose:
    """Returns a grasp at ``position`` that approaches the front of an object (along its -x), fingers closing along y.

    ``roll`` [rad] rotates the fingers about the approach.
    """
    columns = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    return transform(position, rotation_about((1.0, 0.0, 0.0), roll) @ columns)


def kind_of(number: int, kinds: Sequence[str], stream: int) -> str:
    """Returns the kind of object ``number``; ``stream`` separates the random numbers of categories.

    Each block of consecutive numbers contains every kind once, in a random order, so the seen split has all kinds.
    """
    order = np.random.default_rng([number // len(kinds), stream]).permutation(len(kinds))
    return kinds[int(order[number % len(kinds)])]
