"""Roles of external assets' joints and parts by category, and the grasps at their annotated points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

MovingKind = Literal["revolute", "prismatic"]
GraspKind = Literal["facing", "from_above"]


@dataclass(frozen=True)
class JointRole:
    """A joint that a category needs.

    Attributes:
        name: this project's name.
        kind: required type (a continuous joint counts as revolute).
        either_way: whether it turns in both directions from zero.
        upper: default range if the URDF has none [rad or m] (upstream's nominal value).
        damping: see `Joint`; the URDFs of these collections have no usable value.
        extents: longest side of its moving links, for the smallest and the largest generated object [m].
    """

    name: str
    kind: MovingKind
    either_way: bool
    upper: float
    damping: float
    extents: tuple[float, float]


@dataclass(frozen=True)
class PartRole:
    """A part that a category needs.

    Attributes:
        name: this project's name.
        joints: joints that must carry it.
        point_files: files of AdaManip's and UniDoorManip's layouts that may contain its point, preferred ones first.
        grasp: approach direction of the hand.
        roll: rotation of the fingers about the approach [rad] (`facing`, `from_above`).
        past: distance from the annotated point to the tool centre point, along the approach [m]. Upstream keeps the
            hand's origin before the point, with the tool centre point 0.1034 m from it.
        up: upward offset from the annotated point [m].
        round: whether it can be held from every side.
    """

    name: str
    joints: tuple[str, ...]
    point_files: tuple[str, ...]
    grasp: GraspKind
    roll: float = 0.0
    past: float = 0.0
    up: float = 0.0
    round: bool = False


@dataclass(frozen=True)
class Roles:
    """Joints and parts of a category: ``final`` opens it, ``key`` releases it (the paper's names)."""

    final: JointRole
    key: JointRole
    parts: tuple[PartRole, ...]
    folders: tuple[str, ...]
    """Directory names of such objects: this project's first, then AdaManip's."""
    typical_size: float
    """Longest side of an object [m]."""
    partnet: tuple[str, ...] = ()
    """PartNet-Mobility's names for the category."""

    @property
    def joints(self) -> tuple[JointRole, JointRole]:
        """Both joints, final first."""
        return self.final, self.key


QUARTER = 1.5707963267948966
"""A quarter turn [rad]."""
HANDLE_FILES = ("handle_pos.npy", "goal_pos.npy", "handle_bounding.json")
BOTTLE_FILES = ("goal_pos.npy", "handle_pos.npy")
DOOR_FILES = ("handle_bounding.json", "goal_pos.npy", "handle_pos.npy")

ROLES: dict[str, Roles] = {
    "bottle": Roles(
        JointRole("lift", "prismatic", False, 0.05, 5.0, (0.029, 0.052)),
        JointRole("cap", "revolute", True, 2.35, 0.01, (0.029, 0.052)),
        (PartRole("cap", ("lift", "cap"), BOTTLE_FILES, "from_above", QUARTER, 0.0014, round=True),),
        ("bottle",), 0.25, ("Bottle",),
    ),
    "pen": Roles(
        JointRole("lift", "prismatic", False, 0.05, 3.0, (0.037, 0.069)),
        JointRole("cap", "revolute", True, 2.35, 0.01, (0.037, 0.069)),
        (PartRole("cap", ("lift", "cap"), HANDLE_FILES, "from_above", QUARTER, -0.0226, round=True),),
        ("pen",), 0.15, ("Pen",),
    ),
    "pressure_cooker": Roles(
        JointRole("lift", "prismatic", False, 0.05, 5.0, (0.29, 0.41)),
        JointRole("lid", "revolute", True, 0.824, 0.1, (0.29, 0.41)),
        (PartRole("handle", ("lift", "lid"), HANDLE_FILES, "from_above", 0.0, 0.0054),),
        ("pressure_cooker", "pc"), 0.38, ("KitchenPot",),
    ),
    "coffee_maker": Roles(
        JointRole("drop", "prismatic", False, 0.05, 5.0, (0.24, 0.27)),
        JointRole("portafilter", "revolute", True, 0.80, 0.1, (0.24, 0.27)),
        (PartRole("handle", ("drop", "portafilter"), HANDLE_FILES, "from_above", 0.0, 0.0014),),
        ("coffee_maker", "coffee_machine", "cm"), 0.4, ("CoffeeMachine",),
    ),
    "window": Roles(
        JointRole("sash", "revolute", False, 1.57, 1.0, (0.36, 0.61)),
        JointRole("handle", "revolute", True, 1.57, 0.05, (0.075, 0.145)),
        (PartRole("handle", ("sash", "handle"), HANDLE_FILES, "facing", 0.0, 0.0054, 0.01),),
        ("window",), 0.8, ("Window",),
    ),
    "door": Roles(
        JointRole("leaf", "revolute", False, 1.57, 1.0, (0.75, 1.2)),
        JointRole("lever", "revolute", True, 1.05, 0.05, (0.072, 0.138)),
        (PartRole("lever", ("leaf", "lever"), DOOR_FILES, "facing", QUARTER, 0.0014, 0.01),),
        ("door",), 0.9, ("Door",),
    ),
    "lamp": Roles(
        JointRole("button", "prismatic", False, 0.1, 2.0, (0.06, 0.064)),
        JointRole("knob", "revolute", True, 1.57, 0.01, (0.034, 0.043)),
        (PartRole("knob", ("button", "knob"), HANDLE_FILES, "from_above", QUARTER, 0.0034, round=True),),
        ("lamp",), 0.4, ("Lamp",),
    ),
    "microwave": Roles(
        JointRole("door", "revolute", False, 1.578, 1.0, (0.28, 0.39)),
        JointRole("button", "prismatic", False, 0.02, 2.0, (0.036, 0.072)),
        (
            PartRole("handle", ("door",), HANDLE_FILES, "facing", 0.0, 0.0074),
            PartRole("button", ("button",), ("button_pos.npy",), "facing", QUARTER, 0.0),
        ),
        ("microwave", "mv"), 0.5, ("Microwave",),
    ),
    "safe": Roles(
        JointRole("door", "revolute", False, 1.578, 1.0, (0.28, 0.48)),
        JointRole("knob", "revolute", True, 1.4, 0.02, (0.065, 0.072)),
        (
            PartRole("handle", ("door",), HANDLE_FILES, "facing", QUARTER, -0.0066),
            PartRole("knob", ("door", "knob"), ("knob_pos.npy",), "facing", QUARTER, -0.0046),
        ),
        ("safe",), 0.42, ("Safe",),
    ),
}  # fmt: skip
"""By category. Ranges, grasp directions and offsets are from AdaManip's code, as its annotations depend on them."""
