"""Limits of a Franka by model, from the manufacturer's tables, since libraries mix them up.

Sources: Franka Robotics' "Robot and interface specifications" and libfranka's ``rate_limiting.h`` of the releases for
each model. `franky-control` 2.0.0 swaps the two models (it uses Panda's limits for libfranka >= 0.10).
"""

from __future__ import annotations

from dataclasses import dataclass

Seven = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True)
class Bounds[Value]:
    """Maximum velocity, acceleration and jerk: [m] or [rad], per s, s^2 and s^3."""

    velocity: Value
    acceleration: Value
    jerk: Value


@dataclass(frozen=True)
class FrankaLimits:
    """Limits of one model.

    Attributes:
        translation, rotation: bounds of the tool [m, rad].
        elbow: bounds of the third joint, which the elbow commands set [rad].
        joint: bounds of each joint [rad].
        joint_lower, joint_upper: range of each joint [rad].
    """

    translation: Bounds[float]
    rotation: Bounds[float]
    elbow: Bounds[float]
    joint: Bounds[Seven]
    joint_lower: Seven
    joint_upper: Seven


MODELS = {
    "panda": FrankaLimits(
        translation=Bounds(1.7, 13.0, 6500.0),
        rotation=Bounds(2.5, 25.0, 12500.0),
        elbow=Bounds(2.175, 10.0, 5000.0),
        joint=Bounds(
            (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
            (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
            (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
        ),
        joint_lower=(-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
        joint_upper=(2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
    ),
    "fr3": FrankaLimits(
        translation=Bounds(3.0, 9.0, 4500.0),
        rotation=Bounds(2.5, 17.0, 8500.0),
        elbow=Bounds(2.62, 10.0, 5000.0),
        joint=Bounds((2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26), (10.0,) * 7, (5000.0,) * 7),
        joint_lower=(-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159),
        joint_upper=(2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159),
    ),
}
