"""Annotation of an external asset in addition to its URDF, and its file ``adamanip.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lerobot_adamanip.assets.checked_xml import HUGE, annotate_hint, broken
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.objects.base import TWO_FINGERS, Pose
from lerobot_adamanip.util.errors import require_choice
from lerobot_adamanip.util.files import write_atomically
from lerobot_adamanip.util.json_fields import listing, number, read

ANNOTATION_NAME = "adamanip.json"
"""File that `adamanip annotate` writes beside a URDF."""
FORMAT, VERSION = "adamanip-annotation", 1
_NUMBER = number(-HUGE, HUGE)


@dataclass(frozen=True)
class JointChoice:
    """Joint of a role; its positions ``rest`` and ``open`` are in the URDF's units, with sign."""

    joint: str
    rest: float
    open: float


@dataclass(frozen=True)
class PartChoice:
    """Grasp of a part: ``grasp`` (4, 4) [m] in the frame of its link, or in the object frame with joints at rest."""

    link: str
    grasp: Pose
    frame: Literal["link", "object"] = "object"
    rolls: tuple[float, ...] = TWO_FINGERS


@dataclass(frozen=True)
class Annotation:
    """Everything needed to convert a URDF into an object.

    Attributes:
        category: category of the object.
        joints: role of the category -> joint.
        parts: part of the category -> grasp.
        scale: metres per length unit of the URDF.
        object_in_urdf: (4, 4) object frame in the URDF's root frame [m]. None: front along -x, up along z, origin from
            the bounding box (AdaManip, PartNet-Mobility).
    """

    category: str
    joints: Mapping[str, JointChoice]
    parts: Mapping[str, PartChoice] = field(default_factory=dict)
    scale: float = 1.0
    object_in_urdf: Pose | None = None


def read_annotation(path: Path, category: str) -> Annotation:
    """Reads ``adamanip.json``; raises `ConfigurationError` if its category or content is wrong."""

    def wrong(what: str, got: object, allowed: str) -> Exception:
        return broken(path, what, got, allowed, hint=annotate_hint(path, category))

    try:
        content: Any = read(path)
    except (OSError, ValueError) as error:
        raise wrong("cannot be read.", error, "JSON, as `adamanip annotate` saves it") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") != VERSION:
        raise wrong("not an annotation.", str(content)[:80], f"format {FORMAT!r}, version {VERSION}")
    if content.get("category") != category:
        raise wrong("of another category.", content.get("category"), category)
    roles = ROLES[require_choice("category", category, ROLES)]
    joints: Any = content.get("joints")
    parts: Any = content.get("parts")
    missing = [r.name for r in roles.joints if not isinstance(joints, dict) or r.name not in joints]
    missing += [r.name for r in roles.parts if not isinstance(parts, dict) or r.name not in parts]
    if missing:
        raise wrong("incomplete.", f"without {', '.join(missing)}", "a joint for each role, and each part")
    try:
        return Annotation(
            category,
            {r.name: _joint_from_json(joints[r.name]) for r in roles.joints},
            {r.name: _part_from_json(parts[r.name]) for r in roles.parts},
            float(number(1 / HUGE, HUGE)("scale", content["scale"])),
            pose_from_json(content["object_in_urdf"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        got = f"{type(error).__name__}: {error}"
        raise wrong("has a value that cannot be.", got, "finite numbers, (4, 4) rigid transforms, names") from error


def save_annotation(path: Path, annotation: Annotation) -> None:
    """Writes ``adamanip.json`` atomically: after a crash the old file is unchanged."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "category": annotation.category,
        "scale": annotation.scale,
        "object_in_urdf": None if annotation.object_in_urdf is None else annotation.object_in_urdf.tolist(),
        "joints": {k: {"joint": j.joint, "rest": j.rest, "open": j.open} for k, j in annotation.joints.items()},
        "parts": {
            k: {"link": p.link, "grasp": p.grasp.tolist(), "rolls": list(p.rolls)} for k, p in annotation.parts.items()
        },
    }
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    write_atomically(path, text.encode())


def pose_from_json(value: Any) -> Pose:
    """Returns a (4, 4) rigid transform from nested lists; raises ValueError if it is invalid."""
    pose = np.array(listing(listing(_NUMBER, 4, 4), 4, 4)("the transform", value), dtype=np.float64)
    turn = pose[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
    if not rigid or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise ValueError(f"not a rotation and a translation: {value}")
    u, _, v = np.linalg.svd(turn)
    return transform(pose[:3, 3], u @ v)


def _joint_from_json(value: Any) -> JointChoice:
    rest, opened = (float(_NUMBER(name, value[name])) for name in ("rest", "open"))
    if rest == opened:
        raise ValueError(f"joint {value['joint']}: rest and open are equal, {rest}")
    return JointChoice(str(value["joint"]), rest, opened)


def _part_from_json(value: Any) -> PartChoice:
    rolls = tuple(map(float, listing(_NUMBER, 1, 64)("rolls", value["rolls"])))
    return PartChoice(str(value["link"]), pose_from_json(value["grasp"]), "object", rolls)
