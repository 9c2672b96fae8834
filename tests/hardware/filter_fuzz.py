"""Targets of all kinds for the safety filter, and the laws that hold for what it lets through."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from lerobot_adamanip.contract.rotations import (
    Array,
    matrix_from_rotation_6d,
    matrix_from_rotation_vector,
    pose_from_vector,
    pose_vector,
    transform,
)
from lerobot_adamanip.hardware.calibration.hand_shape import franka_hand
from lerobot_adamanip.hardware.safety import SafetyFilter, SafetyLimits
from lerobot_adamanip.hardware.target_geometry import Target, canonical

LIMITS = SafetyLimits((0.2, -0.5, 0.0), (0.8, 0.5, 0.7))
START = transform((0.5, 0.0, 0.35), np.array(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))))
_SURFACE = franka_hand(last_link=False).at(1.0)[0]
HAND = _SURFACE[ConvexHull(_SURFACE).vertices]
"""(N, 3) outermost points of the hand with open fingers, tool frame [m]."""
KINDS = ("near", "far", "jump", "nan", "infinite", "no_rotation", "rough", "huge", "shape")


def random_target(rng: np.random.Generator, kind: str, near: Target) -> Target:
    """A target of one kind, around another."""
    pose = pose_from_vector(near)[0]
    reach = {"near": 0.01, "far": 0.5, "jump": 5.0}.get(kind, 0.05)
    turn = matrix_from_rotation_vector(rng.normal(size=3) * min(reach * 3, 2.0))
    target = pose_vector(
        transform(pose[:3, 3] + rng.normal(size=3) * reach, pose[:3, :3] @ turn), rng.uniform(-0.5, 1.5)
    )
    place = int(rng.integers(10))
    if kind == "nan":
        target[place] = np.nan
    elif kind == "infinite":
        target[place] = np.inf * rng.choice((-1, 1))
    elif kind == "no_rotation":
        target[3:9] = rng.choice((np.zeros(6), np.ones(6), rng.normal(size=6) * 3, np.r_[target[3:6], target[3:6]]))
    elif kind == "rough":
        target[3:9] += rng.normal(size=6) * 0.02
    elif kind == "huge":
        target[place] = rng.choice((-1, 1)) * 10.0 ** rng.uniform(3, 38)
    elif kind == "shape":
        return target[: rng.integers(0, 10)]
    return target


def random_measured(rng: np.random.Generator, last: Target) -> Array:
    """Where the arm is: mostly near the last target, at times pushed away, even out of the box."""
    pose = pose_from_vector(last)[0]
    away = rng.choice((0.0, 0.01, 0.05, 0.4), p=(0.2, 0.5, 0.2, 0.1))
    turned = pose[:3, :3] @ matrix_from_rotation_vector(rng.normal(size=3) * away * 3)
    return transform(pose[:3, 3] + rng.normal(size=3) * away, turned)


def random_dt(rng: np.random.Generator) -> float:
    """Seconds: as of a loop, or of one that stumbled, or of a broken clock."""
    return float(rng.choice((1 / 30, 0.02, 1e-9, 0.0, -1.0, 5.0, np.inf, np.nan)))


def turn_between(first: Array, second: Array) -> float:
    """[rad], by the chord, which is exact for small angles."""
    return 2.0 * float(np.arcsin(min(1.0, float(np.linalg.norm(first - second)) / np.sqrt(8.0))))


def broken_laws(filter_: SafetyFilter, target: Target, measured: Array, dt: float) -> list[str]:
    """Sends one target through the filter; returns what does not hold for what comes out."""
    limits, origin = filter_.limits, filter_.origin(measured).copy()
    again = SafetyFilter(limits)
    again._last = filter_.last
    asked = again.last if (goal := canonical(target)) is None else goal
    assert asked is not None
    out = filter_.stream(target, measured, dt)
    here = filter_._measured(measured).target
    step = max(0.0, min(dt, limits.max_dt)) if np.isfinite(dt) else (limits.max_dt if dt > 0 else 0.0)
    # The filter's own words are used for nothing but where the arm is and what is counted from.
    rotation = matrix_from_rotation_6d(out[3:9])
    points = out[:3].astype(np.float64) + np.vstack((np.zeros(3), HAND)) @ rotation.T
    moved, led = (float(np.linalg.norm(out[:3].astype(np.float64) - place[:3])) for place in (origin, here))
    turned, led_turn = (turn_between(rotation, matrix_from_rotation_6d(place[3:9])) for place in (origin, here))
    laws = {
        "well formed": out.dtype == np.float32 and out.shape == (10,) and bool(np.isfinite(out).all()),
        "box": bool((points >= np.array(limits.box_lower) - 1e-12).all()),
        "box above": bool((points <= np.array(limits.box_upper) + 1e-12).all()),
        "step": moved <= limits.speed * step,
        "turn": turned <= limits.angular_speed * step + 1e-12,
        "lead": led <= limits.lead,
        "angular lead": led_turn <= limits.angular_lead + 1e-12,
        "gripper": out[9] == asked[9],
        "idempotent": again.stream(out, measured, dt).tobytes() == out.tobytes(),
        "orthonormal": bool(np.abs(out[3:9].reshape(2, 3) @ out[3:9].reshape(2, 3).T - np.eye(2)).max() < 1e-5),
    }
    return [name for name, holds in laws.items() if not holds]


def fuzz(count: int, seed: int) -> dict[str, int]:
    """Sends ``count`` targets; returns law -> how often it was broken, and kind -> how many were sent."""
    rng, filter_ = np.random.default_rng(seed), SafetyFilter(LIMITS)
    filter_.anchor(START, 1.0)
    found: dict[str, int] = {}
    for _ in range(count):
        filter_.refused = 0
        last = filter_.last
        assert last is not None
        kind = KINDS[rng.integers(len(KINDS))]
        found[kind] = found.get(kind, 0) + 1
        measured = random_measured(rng, last)
        for law in broken_laws(filter_, random_target(rng, kind, last), measured, random_dt(rng)):
            found[f"broken: {law}"] = found.get(f"broken: {law}", 0) + 1
    return found
