"""Plausibility checks of an external asset's meshes: no important mesh is missing or has a wrong size."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from lerobot_adamanip.assets.annotation.file import Annotation, PartChoice
from lerobot_adamanip.assets.checked_xml import annotate_hint, broken, warn_once_about_asset
from lerobot_adamanip.assets.kinematics import Posed, groups, object_frame
from lerobot_adamanip.assets.meshes import Surface
from lerobot_adamanip.assets.paths import missing_file
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.assets.urdf import Urdf
from lerobot_adamanip.util.errors import listed

SMALLEST, LARGEST = 0.02, 3.0
"""Range of the longest side of an object [m], for all categories."""
OFF = 6.0
"""Ratio to the usual size above which the unit of length must be wrong (inches, centimetres, millimetres)."""
HELD = 0.04
"""Maximum distance of a held mesh from the tool centre point: the finger opening to one side [m]."""


def check_meshes(at_rest: Posed, annotation: Annotation) -> None:
    """Raises `ConfigurationError` if an important part has no mesh or an implausible size."""
    _require_meshes(at_rest, annotation)
    _require_sizes(at_rest, annotation)


def left_out(at_rest: Posed) -> str:
    """Returns the missing meshes of a URDF, as text for descriptions; empty if none is missing."""
    return listed(list(dict.fromkeys(repr(name) for missing in at_rest.missing.values() for name in missing)))


def tell_left_out(at_rest: Posed) -> None:
    """Warns once about missing meshes and about mimic joints, which do not move here."""
    path, followers = at_rest.urdf.path, [joint for joint in at_rest.urdf.moving if joint.mimic is not None]
    if names := left_out(at_rest):
        warn_once_about_asset(f"{path}: names files that are missing, which are left out: {names}")
    for joint in followers:
        assert joint.mimic is not None
        warn_once_about_asset(
            f"{path}: joint {joint.name!r} follows {joint.mimic.leader!r} (mimic); here it stands still"
        )


def _require_meshes(at_rest: Posed, annotation: Annotation) -> None:
    """Requires meshes for moving links, held links, and at least one static link."""
    urdf, roles = at_rest.urdf, ROLES[annotation.category]
    children = {joint.name: joint.child for joint in urdf.joints}
    matter = [children[annotation.joints[role.name].joint] for role in roles.joints]
    matter += [part.link for part in annotation.parts.values()]
    leaders = groups(urdf, annotation.joints)
    still = [name for name, leader in leaders.items() if leader == urdf.root]
    for links in (*([name] for name in matter), still):
        missing = [mesh for name in links for mesh in at_rest.missing.get(name, ())]
        if missing and not any(at_rest.visuals.get(name) for name in links):
            raise missing_file(urdf.path.parent, missing[0])
    for part in annotation.parts.values():
        group = [name for name, leader in leaders.items() if leader == leaders.get(part.link)]
        gaps = [mesh for name in group for mesh in at_rest.missing.get(name, ())]
        if gaps and not _is_held(at_rest, annotation, part, group):
            raise missing_file(urdf.path.parent, gaps[0])


def _is_held(at_rest: Posed, annotation: Annotation, part: PartChoice, links: Iterable[str]) -> bool:
    from scipy.spatial import cKDTree
    from trimesh import Trimesh
    from trimesh.sample import sample_surface

    frame = at_rest.poses[part.link] if part.frame == "link" else object_frame(at_rest, annotation)
    points = [
        sample_surface(Trimesh(surface.vertices, surface.faces, process=False), 4000, seed=0)[0]
        for name in links
        for surface in at_rest.visuals[name]
    ]
    return bool(points) and bool(cKDTree(np.concatenate(points)).query((frame @ part.grasp)[:3, 3])[0] < HELD)


def _require_sizes(at_rest: Posed, annotation: Annotation) -> None:
    """Checks visual and collision sizes: a wrong unit makes a part tens of times too large or too small."""
    roles, urdf = ROLES[annotation.category], at_rest.urdf
    whole = max(SMALLEST, roles.typical_size / OFF), min(LARGEST, OFF * roles.typical_size)
    for surfaces in (at_rest.visuals, at_rest.collisions):
        for role in reversed(roles.joints):  # smaller part first: its error is more specific
            joint = next(each for each in urdf.joints if each.name == annotation.joints[role.name].joint)
            longest, (smallest, largest) = _longest(surfaces, urdf.below(joint.child)), role.extents
            what = f"is of a size no {annotation.category} has." if longest else "moves no shape."
            bounds = smallest / OFF, min(LARGEST, OFF * largest)
            _require_size(urdf, annotation.category, f"its {role.name} {what}", longest, bounds)
        longest = _longest(surfaces, urdf.links)
        _require_size(urdf, annotation.category, "of a size no such object has.", longest, whole)


def _require_size(urdf: Urdf, category: str, what: str, longest: float, bounds: tuple[float, float]) -> None:
    smallest, largest = bounds
    if not smallest <= longest <= largest:
        got, allowed = f"{longest:.3g} m along its longest side", f"{smallest:.2g} ... {largest:.2g} m"
        hint = f"see which unit its meshes state, or set the scale: {annotate_hint(urdf.path, category)}"
        raise broken(urdf.path, what, got, allowed, hint=hint)


def _longest(surfaces: Mapping[str, tuple[Surface, ...]], links: Iterable[str]) -> float:
    """Returns the longest side of the box around links, in the root frame [m]; 0 without shapes."""
    points = [surface.vertices for name in links for surface in surfaces[name]]
    return float(np.ptp(np.concatenate(points), axis=0).max()) if points else 0.0
