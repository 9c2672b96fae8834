"""Conversion of an annotated URDF to this project's object: frame, names, convex collision shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.annotation.file import Annotation, JointChoice
from lerobot_adamanip.assets.checked_xml import annotate_hint, broken
from lerobot_adamanip.assets.kinematics import Posed, groups, object_frame, posed
from lerobot_adamanip.assets.meshes import convex_parts
from lerobot_adamanip.assets.plausible import check_meshes, left_out, tell_left_out
from lerobot_adamanip.assets.roles import ROLES, JointRole, PartRole
from lerobot_adamanip.assets.upstream import check_kind, find_annotation
from lerobot_adamanip.assets.urdf import URDF_NAME, Urdf, read_urdf
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.mechanisms.table import GOAL_MARGIN, infeasible
from lerobot_adamanip.objects.base import (
    ArticulatedObject,
    Joint,
    Link,
    Material,
    PartAnnotation,
    Pose,
    Shape,
    annotate,
)

Array = NDArray[np.float64]
Color = tuple[float, float, float]

NEAR = 0.15
"""Maximum distance of a grasp from the object [m]."""
ROOT_MASS, FINAL_MASS, KEY_MASS = 10.0, 2.0, 0.1
"""Default mass of a link [kg]."""
MASSES = (0.005, 200.0)


def convert_asset(folder: Path, category: str, solid: bool = True) -> ArticulatedObject:
    """Reads a folder and builds its object; ``solid`` adds collision shapes, which may be slow."""
    urdf = read_urdf(folder / URDF_NAME)
    annotation = find_annotation(urdf, category)
    return assemble_object(urdf, annotation, posed(urdf, annotation), solid=solid)


def assemble_object(
    urdf: Urdf, annotation: Annotation, at_rest: Posed, *, solid: bool = True, checked: bool = True
) -> ArticulatedObject:
    """Returns the object of an annotated URDF.

    Args:
        urdf: its description.
        annotation: annotation of the URDF.
        at_rest: the URDF at rest.
        solid: whether to add collision shapes; viewing does not need them.
        checked: whether to check the plausibility of sizes, parts and range; an unfinished annotation may fail.

    Raises:
        ConfigurationError: joints, or, if checked, parts, sizes or ranges do not fit the category.
    """
    check_joint_roles(urdf, annotation)
    if checked:
        check_meshes(at_rest, annotation)
    to_object: Pose = np.linalg.inv(object_frame(at_rest, annotation)).astype(np.float64)
    leaders = groups(urdf, annotation.joints)
    origins = {name: (to_object @ pose)[:3, 3] for name, pose in at_rest.poses.items()} | {urdf.root: np.zeros(3)}
    obj = _Assembly(urdf, annotation, at_rest, to_object, leaders, origins, solid, checked).build()
    if checked and (reason := infeasible(obj)) is not None:
        raise broken(
            urdf.path,
            f"a {annotation.category} like this can never be opened.",
            reason,
            f"joints that go {GOAL_MARGIN:g} times as far as the goal, or farther",
            hint=f"set how far the joint goes: {annotate_hint(urdf.path, annotation.category)}",
        )
    tell_left_out(at_rest)
    return obj


def check_joint_roles(urdf: Urdf, annotation: Annotation) -> None:
    """Raises `ConfigurationError` unless each role has its own joint of the right type."""
    roles, by_name = ROLES[annotation.category], {joint.name: joint for joint in urdf.moving}
    chosen = [annotation.joints[role.name].joint for role in roles.joints]
    hint = annotate_hint(urdf.path, annotation.category)
    if len(set(chosen)) != len(chosen) or not set(chosen) <= set(by_name):
        raise broken(urdf.path, "the annotation's joints are not two of its own.", chosen, list(by_name), hint=hint)
    for role, name in zip(roles.joints, chosen, strict=True):
        joint = by_name[name]
        check_kind(urdf, annotation.category, role, joint)
        if joint.mimic is not None:
            what = f"joint {name!r} cannot be the {role.name}: it does not move by itself."
            free = ", ".join(each.name for each in urdf.leading) or "a joint that follows none"
            raise broken(urdf.path, what, f"it follows joint {joint.mimic.leader!r} (mimic)", free, hint=hint)


@dataclass(frozen=True)
class _Assembly:
    """Intermediate data of a conversion.

    Attributes:
        to_object: (4, 4) transform from the URDF's root frame to the object frame.
        leaders: link -> link that it is rigidly attached to.
        origins: link -> origin (3,) at rest, in the object frame.
        solid, checked: see `assemble_object`.
    """

    urdf: Urdf
    annotation: Annotation
    at_rest: Posed
    to_object: Pose
    leaders: Mapping[str, str]
    origins: Mapping[str, Array]
    solid: bool
    checked: bool

    def build(self) -> ArticulatedObject:
        links = tuple(self._link(name) for name in sorted(set(self.leaders.values()), key=self._order))
        lower, upper = self._box(links)
        depth, width, height = (float(length) for length in upper - lower)
        roles, names = ROLES[self.annotation.category].parts, left_out(self.at_rest)
        without = f", without {names}" if names else ""
        return ArticulatedObject(
            f"{self.annotation.category}:{self.urdf.path.parent.name}",
            self.annotation.category,
            links,
            tuple(self._part(role, links, lower, upper) for role in roles),
            (width, depth, height),
            f"external asset, {len(self.urdf.links)} links, {len(self.urdf.moving)} joints{without}",
            weightless=True,
        )

    def _order(self, link: str) -> tuple[int, bool]:
        """Returns the sort key of a link: parents first, and the final joint's link before the key joint's."""
        above = self.urdf.joint_above(link)
        if above is None:
            return 0, False
        key = self.annotation.joints[ROLES[self.annotation.category].key.name].joint
        return 1 + self._order(above.parent)[0], above.name == key

    def _link(self, name: str) -> Link:
        members = [link for link, leader in self.leaders.items() if leader == name]
        into = transform(-self.origins[name]) @ self.to_object
        shapes: list[Shape] = []
        for member in members:
            shapes += [_mesh(each.vertices, each.faces, into, each.color) for each in self.at_rest.visuals[member]]
            for surface in self.at_rest.collisions[member] if self.solid else ():
                shapes += [_mesh(vertices, faces, into, None) for vertices, faces in convex_parts(surface)]
        mass = sum(self.urdf.links[member].mass or 0.0 for member in members)
        above = self.urdf.joint_above(name)
        if above is None:
            return Link(name, tuple(shapes), _plausible(mass, ROOT_MASS))
        roles = ROLES[self.annotation.category]
        role = next(r for r in roles.joints if self.annotation.joints[r.name].joint == above.name)
        mass = _plausible(mass, FINAL_MASS if role is roles.final else KEY_MASS)
        parent = self.leaders[above.parent]
        axis = self.to_object[:3, :3] @ self.at_rest.poses[name][:3, :3] @ np.asarray(above.axis)
        choice, offset = self.annotation.joints[role.name], self.origins[name] - self.origins[parent]
        return Link(name, tuple(shapes), mass, parent, _joint(role, choice, axis, offset, self.annotation.scale))

    def _box(self, links: tuple[Link, ...]) -> tuple[Array, Array]:
        """Returns the box around all visible shapes, in the object frame with joints at rest."""
        points = [
            shape.vertices + self.origins[link.name]
            for link in links
            for shape in link.shapes
            if shape.visible and shape.vertices is not None
        ]
        if not points:
            raise broken(
                self.urdf.path, "has nothing to be seen.", "no visible shape", "a visual mesh that can be read"
            )
        every = np.concatenate(points)
        return every.min(axis=0), every.max(axis=0)

    def _part(self, role: PartRole, links: tuple[Link, ...], lower: Array, upper: Array) -> PartAnnotation:
        choice, where = self.annotation.parts[role.name], self.urdf.path
        if choice.link not in self.leaders:
            what = f"the {role.name} is annotated on a link that does not exist."
            raise broken(where, what, repr(choice.link), ", ".join(self.leaders))
        grasp = choice.grasp
        if choice.frame == "link":
            grasp = self.to_object @ self.at_rest.poses[choice.link] @ grasp
        part = annotate(links, self.leaders[choice.link], role.name, grasp, choice.rolls)
        carried = {motion.joint for motion in part.motions}
        away = float(np.max(np.maximum(lower - grasp[:3, 3], grasp[:3, 3] - upper)))
        if self.checked and (away > NEAR or not set(role.joints) <= carried):
            raise broken(
                where,
                f"the {role.name} is not where, or on what, a {self.annotation.category} has it.",
                f"moves with {', '.join(sorted(carried)) or 'nothing'}, {max(away, 0):.2f} m outside of the object",
                f"moves with {', '.join(role.joints)}, {NEAR} m outside at most",
                hint=annotate_hint(where, self.annotation.category),
            )
        return part


def _plausible(mass: float, default: float) -> float:
    return mass if MASSES[0] < mass < MASSES[1] else default


def _joint(role: JointRole, choice: JointChoice, axis: Array, origin: Array, scale: float) -> Joint:
    """Returns a joint that is zero at rest and positive towards open; ``either_way`` makes its range symmetric."""
    travel = (choice.open - choice.rest) * (scale if role.kind == "prismatic" else 1.0)
    direction = axis * np.sign(travel)
    limits = (-abs(travel) if role.either_way else 0.0, abs(travel))
    x, y, z = (float(value) for value in direction)
    a, b, c = (float(value) for value in origin)
    return Joint(role.name, role.kind, (x, y, z), (a, b, c), limits, role.damping)


def _mesh(vertices: Array, faces: NDArray[np.int64], into: Pose, color: Color | None) -> Shape:
    """Returns a mesh in its link's frame: visible if it has a colour, otherwise solid."""
    moved = np.ascontiguousarray(vertices @ into[:3, :3].T + into[:3, 3], np.float32)
    look, seen = Material(color or (0.5, 0.5, 0.5)), color is not None
    return Shape("mesh", (), np.eye(4), look, not seen, moved, np.ascontiguousarray(faces, np.int32), seen)
