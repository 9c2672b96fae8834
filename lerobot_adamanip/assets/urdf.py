"""Parser of untrusted URDF files; reads nothing outside the given text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from lerobot_adamanip.assets.checked_xml import broken, numbers, parse_xml, warn_once_about_asset
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.objects.base import Pose
from lerobot_adamanip.util.errors import ConfigurationError

UrdfJointKind = Literal["fixed", "revolute", "continuous", "prismatic"]
GeometryKind = Literal["box", "cylinder", "sphere", "mesh"]
JOINT_KINDS: tuple[UrdfJointKind, ...] = ("fixed", "revolute", "continuous", "prismatic")
URDF_NAME = "mobility.urdf"
"""File name of the URDF in every layout."""
MAX_BYTES = 8_000_000
MAX_LINKS = 1000
SIZES = {
    "box": (3, "", ("size",)), "sphere": (1, "", ("radius",)), "cylinder": (2, "", ("radius", "length")),
    "mesh": (3, "1 1 1", ("scale",)),
}  # fmt: skip
"""Shape -> number of values, default value, and the attributes that hold them."""


@dataclass(frozen=True)
class Geometry:
    """A visual or collision element in its link's frame at ``pose`` (4, 4); ``size`` as in URDF (box: full extents;
    cylinder: radius, length; sphere: radius; mesh: scale along x, y, z).
    """

    kind: GeometryKind
    size: tuple[float, ...]
    pose: Pose
    mesh: str = ""
    color: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class UrdfLink:
    """A link; ``mass`` [kg] is None if the file has no usable one."""

    name: str
    visuals: tuple[Geometry, ...]
    collisions: tuple[Geometry, ...]
    mass: float | None


@dataclass(frozen=True)
class UrdfJoint:
    """A joint; ``pose`` (4, 4) is the child frame in the parent at zero, ``axis`` (3,) a unit vector in the child.

    ``mimic``: the joint that it follows; None for an independent joint.
    """

    name: str
    kind: UrdfJointKind
    parent: str
    child: str
    pose: Pose
    axis: tuple[float, float, float]
    limits: tuple[float, float] | None
    mimic: Mimic | None = None


@dataclass(frozen=True)
class Mimic:
    """Coupling of a joint: ``multiplier`` times the position of the joint ``leader``, plus ``offset`` [rad or m]."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Urdf:
    """A tree of links; joints in file order."""

    path: Path
    links: dict[str, UrdfLink]
    joints: tuple[UrdfJoint, ...]
    root: str

    @property
    def moving(self) -> tuple[UrdfJoint, ...]:
        """All joints that are not fixed."""
        return tuple(joint for joint in self.joints if joint.kind != "fixed")

    @property
    def leading(self) -> tuple[UrdfJoint, ...]:
        """All independent joints."""
        return tuple(joint for joint in self.moving if joint.mimic is None)

    def below(self, link: str) -> list[str]:
        """Returns a link and all its descendants."""
        links = [link]
        for name in links:  # grows during iteration
            links += [joint.child for joint in self.joints if joint.parent == name]
        return links

    def joint_above(self, link: str) -> UrdfJoint | None:
        """Returns the joint whose child is ``link``; None for the root."""
        return next((joint for joint in self.joints if joint.child == link), None)


def read_urdf(path: Path) -> Urdf:
    """Reads a URDF.

    Raises:
        ConfigurationError: the file is missing, not XML, has a document type (entities), or is not a tree of links.
    """
    if not path.is_file():
        raise broken(path, "no such file.", "nothing", f"a folder with a {URDF_NAME}", hint="the folder of one object")
    if path.stat().st_size > MAX_BYTES:
        raise broken(path, "too large.", f"{path.stat().st_size} bytes", f"{MAX_BYTES} bytes")
    robot = parse_xml(path, path.read_bytes())
    if robot.tag != "robot":
        raise broken(path, "not a URDF.", f"<{robot.tag}>", "<robot> as its root")
    colors = {str(m.get("name")): _color(path, m.find("color")) for m in robot.findall("material")}
    links = [_link(path, element, colors) for element in robot.findall("link")]
    joints = tuple(_joint(path, element) for element in robot.findall("joint"))
    return Urdf(path, {link.name: link for link in links}, joints, _checked_root(path, links, joints))


Colors = dict[str, tuple[float, float, float] | None]


def _origin(path: Path, element: Any, where: str) -> Pose:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    position = numbers(path, origin.get("xyz", "0 0 0"), 3, f"the origin of {where}")
    angles = numbers(path, origin.get("rpy", "0 0 0"), 3, f"the orientation of {where}")
    return transform(position, Rotation.from_euler("xyz", angles).as_matrix())


def _color(path: Path, element: Any) -> tuple[float, float, float] | None:
    """Returns the colour of ``<color rgba>``, with or without alpha; None if it is unreadable."""
    if element is None:
        return None
    written = element.get("rgba", "")
    try:
        values = numbers(path, written, 4 if len(written.split()) == 4 else 3, "a colour")
    except ConfigurationError:
        warn_once_about_asset(f"{path}: colour {written[:80]!r} left out: not 3 or 4 numbers")
        return None
    # Files contain sRGB colours; shaders use linear ones.
    red, green, blue = np.clip(values[:3], 0, 1) ** 2.2
    return float(red), float(green), float(blue)


def _name(path: Path, element: Any, what: str) -> str:
    name: str = element.get("name", "")
    if not name:
        raise broken(path, f"a {what} has no name.", f"<{element.tag}>", f"a name for every {what}")
    return name


def _link(path: Path, element: Any, colors: Colors) -> UrdfLink:
    name = _name(path, element, "link")

    def all_of(tag: str) -> tuple[Geometry, ...]:
        return tuple(_geometry(path, item, name, colors) for item in element.findall(tag))

    mass = None
    if (stated := element.find("inertial/mass")) is not None:
        mass = numbers(path, stated.get("value", ""), 1, f"the mass of {name}")[0]
    return UrdfLink(name, all_of("visual"), all_of("collision"), mass)


def _geometry(path: Path, element: Any, link: str, colors: Colors) -> Geometry:
    where = f"a {element.tag} of {link}"
    pose = _origin(path, element, where)
    color = None
    if (material := element.find("material")) is not None:
        color = _color(path, material.find("color")) or colors.get(material.get("name", ""))
    shape: Any = next(iter(element.findall("geometry/*")), None)
    if shape is None or shape.tag not in SIZES:
        got = "nothing" if shape is None else shape.tag
        raise broken(path, f"{where} has no shape that can be used.", got, ", ".join(SIZES))
    count, default, attributes = SIZES[shape.tag]
    size = numbers(path, " ".join(shape.get(name, default) for name in attributes), count, where)
    if (not all(value > 0 for value in size) and shape.tag != "mesh") or not all(size):
        raise broken(path, f"{where} has no extent.", size, "positive sizes")
    return Geometry(shape.tag, size, pose, shape.get("filename", ""), color)


def _joint(path: Path, element: Any) -> UrdfJoint:
    name, kind = _name(path, element, "joint"), element.get("type", "")
    if kind not in JOINT_KINDS:
        raise broken(path, f"joint {name!r} has a type that is not known here.", repr(kind), ", ".join(JOINT_KINDS))
    ends = [element.find(end).get("link", "") if element.find(end) is not None else "" for end in ("parent", "child")]
    written = element.find("axis")
    axis = np.array((1.0, 0.0, 0.0) if written is None else numbers(path, written.get("xyz", ""), 3, f"axis of {name}"))
    if kind != "fixed" and np.linalg.norm(axis) < 1e-6:
        raise broken(path, f"the axis of {name!r} has no direction.", axis, "a vector that is not zero")
    unit = axis / max(float(np.linalg.norm(axis)), 1e-12)
    limits, limit = None, element.find("limit")
    if limit is not None and kind in ("revolute", "prismatic"):
        both = f"{limit.get('lower', '0')} {limit.get('upper', '0')}"
        lower, upper = numbers(path, both, 2, f"the limits of {name}")
        limits = (min(lower, upper), max(lower, upper))
    pose = _origin(path, element, f"joint {name}")
    direction, mimic = (float(unit[0]), float(unit[1]), float(unit[2])), None
    if (follows := element.find("mimic")) is not None and kind != "fixed":
        both = f"{follows.get('multiplier', '1')} {follows.get('offset', '0')}"
        mimic = Mimic(follows.get("joint", ""), *numbers(path, both, 2, f"how {name} follows another joint"))
    return UrdfJoint(name, kind, ends[0], ends[1], pose, direction, limits, mimic)


def _checked_root(path: Path, links: list[UrdfLink], joints: tuple[UrdfJoint, ...]) -> str:
    """Returns the name of the root; raises an error unless the links form one tree."""
    names = [link.name for link in links]
    known = set(names)
    if not 0 < len(names) <= MAX_LINKS or len(known) != len(names):
        raise broken(path, "link names are not unique, or none or too many.", len(names), f"1 to {MAX_LINKS} names")
    parents = {joint.child: joint.parent for joint in joints}
    roots = [name for name in names if name not in parents]
    reached = set(roots)
    while grown := {child for child, parent in parents.items() if parent in reached} - reached:
        reached |= grown
    ends = [f"{joint.parent!r} -> {joint.child!r}" for joint in joints if not {joint.parent, joint.child} <= known]
    if len({joint.name for joint in joints}) != len(joints):
        raise broken(path, "joint names are not unique.", [joint.name for joint in joints], "a name for each")
    if ends:
        raise broken(path, "a joint names a link that does not exist.", ends[0], ", ".join(names[:20]))
    if len(roots) != 1 or len(parents) != len(joints) or reached != known:
        got = f"roots {roots}, {len(joints)} joints"
        raise broken(path, "the links are not one tree.", got, "one root, and one joint above every other link")
    return roots[0]
