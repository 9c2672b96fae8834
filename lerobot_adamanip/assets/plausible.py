"""Whether an external asset's meshes can be its category's: nothing that matters is missing, or of a wrong size."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.assets.annotation.file import Annotation, PartChoice
from lerobot_adamanip.assets.checked_xml import annotate_hint, broken, warn_once
from lerobot_adamanip.assets.kinematics import Posed, groups, object_frame
from lerobot_adamanip.assets.meshes import Surface
from lerobot_adamanip.assets.paths import missing_file
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.assets.urdf import Urdf
from lerobot_adamanip.util.errors import listed

Array = NDArray[np.float64]

SMALLEST, LARGEST = 0.02, 3.0
"""Longest side of an object that is plausible in metres, whatever its category."""
OFF = 6.0
"""A size this many times smaller or larger than usual is a wrong unit (inches, centimetres, millimetres)."""
HELD = 0.04
"""What a hand holds is no farther from its tool centre point than its fingers open to one side [m]."""


def check_meshes(found: Posed, annotation: Annotation) -> None:
    """Raises `ConfigurationError` if a part that matters has no mesh left, or is of a size that it cannot have."""
    _require_meshes(found, annotation)
    _require_sizes(found, annotation)


def left_out(found: Posed) -> str:
    """Returns the meshes that a URDF names and its folder does not hold, for descriptions; an empty text if none."""
    return listed(list(dict.fromkeys(repr(name) for missing in found.missing.values() for name in missing)))


def tell_left_out(found: Posed) -> None:
    """Warns, once, of meshes that are missing and of joints that do not follow the one they should."""
    path, followers = found.urdf.path, [joint for joint in found.urdf.moving if joint.mimic is not None]
    if names := left_out(found):
        warn_once(f"{path}: names files that are missing, which are left out: {names}")
    for joint in followers:
        assert joint.mimic is not None
        warn_once(f"{path}: joint {joint.name!r} follows {joint.mimic.leader!r} (mimic); here it stands still")


def _require_meshes(found: Posed, annotation: Annotation) -> None:
    """What the joints move and what is held has to be there; and so has something of what stands still."""
    urdf, roles = found.urdf, ROLES[annotation.category]
    children = {joint.name: joint.child for joint in urdf.joints}
    matter = [children[annotation.joints[role.name].joint] for role in roles.joints]
    matter += [part.link for part in annotation.parts.values()]
    leaders = groups(urdf, annotation.joints)
    still = [name for name, leader in leaders.items() if leader == urdf.root]
    for links in (*([name] for name in matter), still):
        missing = [mesh for name in links for mesh in found.missing.get(name, ())]
        if missing and not any(found.visuals.get(name) for name in links):
            raise missing_file(urdf.path.parent, missing[0])
    for part in annotation.parts.values():
        group = [name for name, leader in leaders.items() if leader == leaders.get(part.link)]
        gaps = [mesh for name in group for mesh in found.missing.get(name, ())]
        if gaps and not _is_held(found, annotation, part, group):
            raise missing_file(urdf.path.parent, gaps[0])


def _is_held(found: Posed, annotation: Annotation, part: PartChoice, links: Iterable[str]) -> bool:
    from scipy.spatial import cKDTree
    from trimesh import Trimesh
    from trimesh.sample import sample_surface

    frame = found.poses[part.link] if part.frame == "link" else object_frame(found, annotation)
    points = [
        sample_surface(Trimesh(surface.vertices, surface.faces, process=False), 4000, seed=0)[0]
        for name in links
        for surface in found.visuals[name]
    ]
    return bool(points) and bool(cKDTree(np.concatenate(points)).query((frame @ part.grasp)[:3, 3])[0] < HELD)


def _require_sizes(found: Posed, annotation: Annotation) -> None:
    """Seen and solid alike: a unit that is read wrong makes a part tens of times too large or too small."""
    roles, urdf = ROLES[annotation.category], found.urdf
    least, most = max(SMALLEST, roles.typical_size / OFF), min(LARGEST, OFF * roles.typical_size)
    for surfaces in (found.visuals, found.collisions):
        for role in reversed(roles.joints):  # the smaller part first: it tells more than the larger that carries it
            joint = next(each for each in urdf.joints if each.name == annotation.joints[role.name].joint)
            longest, (smallest, largest) = _longest(surfaces, _below(urdf, joint.child)), role.extents
            what = f"is of a size no {annotation.category} has." if longest else "moves no shape."
            _require_size(urdf, f"its {role.name} {what}", longest, smallest / OFF, min(LARGEST, OFF * largest))
        _require_size(urdf, "of a size no such object has.", _longest(surfaces, urdf.links), least, most)


def _require_size(urdf: Urdf, what: str, longest: float, least: float, most: float) -> None:
    if not least <= longest <= most:
        got, allowed = f"{longest:.3g} m along its longest side", f"{least:.2g} ... {most:.2g} m"
        hint = f"see which unit its meshes state, or {annotate_hint(urdf.path)}, and set the scale"
        raise broken(urdf.path, what, got, allowed, hint=hint)


def _longest(surfaces: Mapping[str, tuple[Surface, ...]], links: Iterable[str]) -> float:
    """The longest side of the box around links, root frame [m]; 0 if they have no shape."""
    points = [surface.vertices for name in links for surface in surfaces[name]]
    return float(np.ptp(np.concatenate(points), axis=0).max()) if points else 0.0


def _below(urdf: Urdf, link: str) -> list[str]:
    """A link and all that moves with it."""
    links = [link]
    for name in links:  # grows while it is gone through
        links += [joint.child for joint in urdf.joints if joint.parent == name]
    return links
