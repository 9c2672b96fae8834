"""Levels of sensing, and the errors of depth images, without a simulator."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.contract.sensing import BASELINE_M, FOCAL_PX, LEVELS, Sensing, parse_sensing
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.looks import Look
from lerobot_env_adamanip.sim.sensing import SensorErrors, absorption, measured_depth, random_motion

SIZE, FOCAL = 240, 246.0
D435, NONE = LEVELS["d435"], np.zeros((SIZE, SIZE), np.float32)


def plane(distance: float, slope: float = 0.0) -> np.ndarray[Any, Any]:
    """Depth of a plane, whose inverse grows to the right by ``slope`` per pixel."""
    return np.float32(1 / (1 / distance + slope * (np.arange(SIZE) - SIZE / 2))) + NONE


def measure(depth: Any, sensing: Sensing = D435, absorbed: Any = NONE, seed: int = 0) -> Any:
    rng = np.random.default_rng(seed)
    return measured_depth(depth, absorbed, focal=FOCAL, sensing=sensing, rng=rng)


# Levels -----------------------------------------------------------------------------------------------------------


def test_a_level_and_its_changed_parts() -> None:
    assert parse_sensing("exact") == Sensing()
    assert parse_sensing("d435") == D435
    assert parse_sensing("d435, camera_error_mm=20 ,lost=0") == replace(D435, camera_error_mm=20.0, lost=0.0)


def test_each_level_is_worse_than_the_one_before() -> None:
    for part in fields(Sensing):
        values = [getattr(level, part.name) for level in LEVELS.values()]
        assert values == sorted(values), part.name
        assert values[0] == 0
    assert [level.steps_late(10) for level in LEVELS.values()] == [0, 1, 2]
    assert [Sensing(latency_ms=each).steps_late(10) for each in (40, 50, 150, 250)] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("", "exact, d435, rough"),
        ("d453", "try:     --env.sensing=d435"),
        ("camera_error_mm=20", "a level first"),
        ("d435,camera_error=20", "--env.sensing=d435,camera_error_mm=20"),
        ("d435,lost", "lost from 0 to 0.9"),
        ("d435,lost=nan", "lost from 0 to 0.9"),
        ("d435,lost=-0.1", "lost from 0 to 0.9"),
        ("d435,lost=1", "lost from 0 to 0.9"),
        ("d435,lost=\u0660", "lost from 0 to 0.9"),  # a zero for Python, but not in a log
    ],
)
def test_what_is_no_sensing_is_one_clear_error(wrong: str, said: str) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:") as caught:
        parse_sensing(wrong)
    assert said in str(caught.value)


# Depth ------------------------------------------------------------------------------------------------------------


def test_no_error_changes_nothing_but_rounding() -> None:
    depth = plane(0.9, 1e-3)
    assert measure(depth, Sensing()) == pytest.approx(depth, rel=1e-6)


@pytest.mark.parametrize("distance", [0.5, 0.85, 1.2, 2.0])
def test_noise_grows_with_the_square_of_the_distance(distance: float) -> None:
    """As Intel's formula has it, plus the steps of the disparity."""
    error = measure(plane(distance), replace(D435, lost=0.0)) - np.float32(distance)
    formula = distance**2 * np.hypot(0.08, 1 / 32 / 12**0.5) / (FOCAL_PX * BASELINE_M)
    assert float(error.std()) == pytest.approx(formula, rel=0.1)
    assert abs(float(error.mean())) < 0.5 * formula


def test_depth_comes_in_steps_of_the_disparity() -> None:
    disparity = FOCAL_PX * BASELINE_M / measure(plane(0.9, 1e-3), replace(D435, lost=0.0))
    steps = disparity * 32
    assert np.abs(steps - np.round(steps)).max() < 0.01


def test_patches_are_lost_in_their_share() -> None:
    lost = np.mean([np.isinf(measure(plane(0.9), replace(D435, lost=0.2), seed=seed)).mean() for seed in range(8)])
    assert 0.15 < lost < 0.25
    alone = np.isinf(measure(plane(0.9), replace(D435, lost=0.2)))
    assert np.mean(alone[1:] == alone[:-1]) > 0.95, "in patches, not pixel by pixel"


def test_a_surface_seen_at_a_grazing_angle_returns_nothing() -> None:
    slopes = {degrees: 1 / (0.9 * FOCAL * np.tan(np.radians(degrees))) for degrees in (6.0, 30.0)}
    middle = slice(SIZE // 2 - 5, SIZE // 2 + 5)
    share = {
        degrees: np.isinf(measure(plane(0.9, slope), replace(D435, lost=0.0))[:, middle]).mean()
        for degrees, slope in slopes.items()
    }
    assert share[6.0] > 0.9
    assert share[30.0] < 0.1


def test_edges_have_holes_flying_points_and_a_shadow_on_their_left() -> None:
    depth = plane(1.1)
    depth[80:160, 80:160] = 0.8
    measured = measure(depth, replace(D435, lost=0.0, flying=0.3))
    assert np.isinf(measured[90:150, 76:79]).mean() > 0.9, "hidden from the right imager"
    inner = measured[90:150, 100:140]
    assert np.isfinite(inner).all()
    ring = np.concatenate([measured[90:150, 159:161].ravel(), measured[79:81, 90:150].ravel()])
    assert 0.3 < np.isinf(ring).mean() < 0.7
    between = (ring > 0.83) & (ring < 1.07)
    assert 0.05 < between.mean() < 0.3


def test_black_glass_and_polished_parts_return_less() -> None:
    colors = np.array([[0.6, 0.6, 0.6], [0.01, 0.01, 0.01], [0.6, 0.6, 0.6]], np.float32)
    look = Look(np.zeros((3, 3, 3), np.float32), colors, np.array([0.4, 0.4, 0.9], np.float32))
    assert absorption(look).tolist() == [0.0, 1.0, 1.0]
    absorbed = NONE.copy()
    absorbed[:, SIZE // 2 :] = 1.0
    lost = np.isinf(measure(plane(0.9), absorbed=absorbed))
    assert lost[:, : SIZE // 2].mean() < 0.1
    assert 0.4 < lost[:, SIZE // 2 :].mean() < 0.6


def test_equal_generators_give_equal_depth() -> None:
    depth = plane(0.9)
    np.testing.assert_array_equal(measure(depth), measure(depth))
    assert not np.array_equal(measure(depth), measure(depth, seed=1))


def test_a_picture_of_nothing_stays_one() -> None:
    assert np.isinf(measure(np.full((SIZE, SIZE), np.inf, np.float32))).all()


# Rigid errors -----------------------------------------------------------------------------------------------------


def errors(sensing: Sensing = D435, seed: int = 0, **others: Any) -> SensorErrors:
    return SensorErrors(sensing, seed, "safe", DEFAULT_WORKSPACE, **{"moment": lambda: 0, **others})


def test_a_rigid_error_has_its_size_in_the_middle_of_the_workspace() -> None:
    middle = np.array([[0.55, 0.0, 0.765]], np.float32)
    made = [errors(replace(D435, arm_error_mm=0.0, arm_error_deg=0.0), seed) for seed in range(5)]
    moved = [one.reported(middle, np.eye(4))[0] - middle[0] for one in made]
    assert np.linalg.norm(moved, axis=1) == pytest.approx(7e-3, rel=1e-3)
    assert len({tuple(np.sign(shift)) for shift in moved}) > 1, "in all directions"


def test_the_camera_stands_where_its_clouds_are_reported_from() -> None:
    one = errors(replace(D435, arm_error_mm=0.0, arm_error_deg=0.0))
    reported = random_motion(np.random.default_rng(1), 800.0, 30.0)
    true, in_camera = one.true_pose("front", reported), np.array([0.1, 0.2, 0.9, 1.0])
    seen = (true @ in_camera)[None, :3]
    assert one.reported(seen, np.eye(4))[0] == pytest.approx((reported @ in_camera)[:3], abs=1e-6)


def test_the_error_of_the_arm_turns_with_the_tool() -> None:
    one = errors(Sensing(arm_error_mm=3.0))
    tool = random_motion(np.random.default_rng(1), 500.0, 90.0)
    shift = [one.reported(pose[None, :3, 3], pose)[0] - pose[:3, 3] for pose in (np.eye(4), tool)]
    assert np.linalg.norm(shift, axis=1) == pytest.approx(3e-3, rel=1e-3)
    assert tool[:3, :3] @ shift[0] == pytest.approx(shift[1], abs=1e-6)


def test_a_moment_is_seen_alike_as_often_as_somebody_looks() -> None:
    effort = np.zeros(7)
    assert np.array_equal(errors().effort(effort), errors().effort(effort))
    later = errors(moment=lambda: 1).effort(effort)
    assert not np.array_equal(errors().effort(effort), later)
    assert np.std([errors(moment=lambda now=now: now).effort(effort) for now in range(200)]) == pytest.approx(0.1, 0.1)


def test_what_is_delayed_comes_as_it_was() -> None:
    now = 0
    one = errors(moment=lambda: now, delay=5)
    seen = []
    for now in (0, 5, 10, 15, 15):
        one.delayed("point_cloud", now)
        seen.append(one.delayed("point_cloud", now))
    assert seen == [0, 0, 5, 10, 10]
