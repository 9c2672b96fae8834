"""What an object is: links of simple shapes, joints, and annotated part poses. Pure data, no simulator."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lerobot_adamanip.rotations import rotated_about_line, rotation_about, transform

Pose = NDArray[np.float64]
ShapeKind = Literal["box", "cylinder", "capsule", "mesh"]
JointKind = Literal["fixed", "revolute", "prismatic"]


@dataclass(frozen=True)
class Material:
    """Surface: linear RGB colour in [0, 1], and the two numbers of a metallic-roughness shader."""

    color: tuple[float, float, float]
    roughness: float = 0.6
    metallic: float = 0.0


@dataclass(frozen=True)
class Shape:
    """A visual and, unless told otherwise, collision primitive of a link.

    Attributes:
        kind: ``box`` (size = half extents), ``cylinder`` / ``capsule`` (size = radius, half length; the axis is x),
            or ``mesh`` (convex, from ``vertices`` and ``faces``).
        size: [m].
        pose_in_link: (4, 4).
        material: look.
        collides: whether it is solid, or decoration only.
        vertices: (V, 3) [m] for a mesh.
        faces: (F, 3) vertex indices for a mesh.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose_in_link: Pose
    material: Material
    collides: bool = True
    vertices: NDArray[np.float32] | None = None
    faces: NDArray[np.int32] | None = None


@dataclass(frozen=True)
class Joint:
    """How a link moves on its parent.

    The link's frame sits at its joint's origin, at position zero with axes parallel to the parent's.

    Attributes:
        name: as mechanisms call it.
        kind: type.
        axis: (3,) unit vector, parent frame.
        origin: (3,) a point on the axis, parent frame [m].
        limits: [rad or m].
        friction: Coulomb friction [N m or N].
        damping: viscous damping [N m s/rad or N s/m].
    """

    name: str
    kind: JointKind
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    limits: tuple[float, float] = (0.0, 0.0)
    friction: float = 0.0
    damping: float = 0.0


@dataclass(frozen=True)
class Link:
    """A rigid body: shapes on a joint under a parent (the root has neither)."""

    name: str
    shapes: tuple[Shape, ...]
    mass: float
    parent: str | None = None
    joint: Joint | None = None


@dataclass(frozen=True)
class PartAnnotation:
    """The annotated pose of a part a robot can hold: the paper's part pose, as a grasp (appendix "Pose Annotation").

    Attributes:
        name: part, ``handle`` or ``knob``.
        grasp: (4, 4) tool pose when holding it: z is the approach direction, y the direction the fingers close in.
        axis_point: (3,) a point on the axis the part turns about [m].
        axis: (3,) unit vector of that axis; a positive joint position turns about it by the right-hand rule.
    """

    name: str
    grasp: Pose
    axis_point: NDArray[np.float64]
    axis: NDArray[np.float64]

    def turned(self, angle: float) -> Pose:
        """Returns the (4, 4) grasp after the part has turned by ``angle`` [rad]."""
        return rotated_about_line(self.grasp, self.axis_point, self.axis, angle)

    def in_frame(self, frame: Pose) -> PartAnnotation:
        """Returns this annotation expressed in the frame in which ``frame`` (4, 4) is its present frame's pose."""
        return replace(
            self,
            grasp=frame @ self.grasp,
            axis_point=frame[:3, :3] @ self.axis_point + frame[:3, 3],
            axis=frame[:3, :3] @ self.axis,
        )


@dataclass(frozen=True)
class ArticulatedObject:
    """One object. Its frame: on the floor under the middle of its front, x out of the front, z up [m].

    Attributes:
        object_id: ``safe_007``.
        category: ``safe``.
        links: root first, parents before children.
        parts: annotations in the object frame, joints at zero.
        size: (width, depth, height) of the bounding box [m].
        description: the drawn parameters, for labels and cards.
    """

    object_id: str
    category: str
    links: tuple[Link, ...]
    parts: tuple[PartAnnotation, ...]
    size: tuple[float, float, float]
    description: str = ""

    def part(self, name: str) -> PartAnnotation:
        """Returns the annotation of a part; KeyError that lists the parts if there is none of that name."""
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"{self.object_id} has no part {name!r}; it has {[part.name for part in self.parts]}")

    def joint(self, name: str) -> Joint:
        """Returns a joint by name."""
        return next(link.joint for link in self.links if link.joint is not None and link.joint.name == name)


def facing(position: ArrayLike, roll: float = 0.0) -> Pose:
    """Returns a grasp at ``position`` that approaches the front of an object (along its -x), fingers closing along y.

    ``roll`` [rad] turns the fingers about the approach.
    """
    columns = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    return transform(position, rotation_about((1.0, 0.0, 0.0), roll) @ columns)
