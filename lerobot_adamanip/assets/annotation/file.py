"""Annotation of an external asset in addition to its URDF, and its file ``adamanip.json``."""

from __future__ import annotations

import json
import math
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
from lerobot_adamanip.util.json_fields import read

ANNOTATION_NAME = "adamanip.json"
"""File that `adamanip annotate` writes beside a URDF."""
FORMAT, VERSION = "adamanip-annotation", 1


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
            _scale(content["scale"]),
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
    pose = np.array(value, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or np.abs(pose).max() > HUGE:
        raise ValueError(f"not a finite (4, 4) transform: {value}")
    turn = pose[:3, :3]
    rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) and np.linalg.det(turn) > 0
    if not rigid or not np.allclose(pose[3], (0, 0, 0, 1)):
        raise ValueError(f"not a rotation and a translation: {value}")
    u, _, v = np.linalg.svd(turn)
    return transform(pose[:3, 3], u @ v)


def _joint_from_json(value: Any) -> JointChoice:
    choice = JointChoice(str(value["joint"]), float(value["rest"]), float(value["open"]))
    if not (math.isfinite(choice.rest) and math.isfinite(choice.open)) or choice.rest == choice.open:
        raise ValueError(f"joint {choice.joint}: rest {choice.rest} and open {choice.open} are equal or not finite")
    return choice


def _part_from_json(value: Any) -> PartChoice:
    rolls = tuple(float(roll) for roll in value["rolls"])
    if not rolls or not all(map(math.isfinite, rolls)) or len(rolls) > 64:
        raise ValueError(f"rolls are {rolls}, not 1 to 64 finite angles")
    return PartChoice(str(value["link"]), pose_from_json(value["grasp"]), "object", rolls)


def _scale(value: Any) -> float:
    scale = float(value)
    if not (math.isfinite(scale) and 1e-4 < scale < 1e4):
        raise ValueError(f"scale is {scale}, not a number from 0.0001 to 10000")
    return scale
