"""Annotated parts as JSON: what the twin's process tells of an episode, and what a scripted teleoperator plays by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.objects import PartAnnotation
from lerobot_adamanip.objects.base import Motion
from lerobot_adamanip.util import json_fields as checked_json

_NUMBER = checked_json.number(-1e6, 1e6)
_NAME = checked_json.text(r"\w{1,40}", "a name")
_POSE = checked_json.listing(checked_json.listing(_NUMBER, 4, 4), 4, 4)
_THREE = checked_json.listing(_NUMBER, 3, 3)
_MOTION = checked_json.table(
    {
        "joint": _NAME,
        "kind": checked_json.choice(("revolute", "prismatic", "fixed")),
        "point": _THREE,
        "axis": _THREE,
    }
)
_PART = checked_json.table(
    {
        "grasp": _POSE,
        "motions": checked_json.listing(_MOTION, 0, 8),
        "rolls": checked_json.listing(_NUMBER, 0, 64),
    }
)
_PARTS = checked_json.mapping(_NAME, _PART, 32)


def annotations_json(parts: Mapping[str, PartAnnotation]) -> dict[str, Any]:
    """Returns annotations as `annotations_from_json` takes them."""
    return {
        name: {
            "grasp": part.grasp.tolist(),
            "motions": [
                {"joint": each.joint, "kind": each.kind, "point": each.point.tolist(), "axis": each.axis.tolist()}
                for each in part.motions
            ],
            "rolls": [float(roll) for roll in part.rolls],
        }
        for name, part in parts.items()
    }


def annotations_from_json(value: object) -> dict[str, PartAnnotation]:
    """Returns the annotated parts, robot base frame, joints at zero. Raises ValueError that names a wrong field."""
    found = _PARTS("the annotations", value)
    return {
        name: PartAnnotation(
            name,
            _array(part["grasp"]),
            tuple(
                Motion(each["joint"], each["kind"], _array(each["point"]), _array(each["axis"]))
                for each in part["motions"]
            ),
            part["rolls"],
        )
        for name, part in found.items()
    }


def _array(value: object) -> NDArray[np.float64]:
    return np.array(value, np.float64)
