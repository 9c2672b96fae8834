"""The safety filter's laws: box, step, speed, lead, refusal, and that applying it twice is applying it once."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from filter_fuzz import HAND, LIMITS, START, broken_laws, fuzz
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import ConvexHull

from lerobot_adamanip.contract.rotations import pose_from_vector, pose_vector, rotation_about, straight_path, transform
from lerobot_adamanip.hardware.safety import HAND_CORNERS, MAX_REACH_M, MAX_REFUSED, SafetyFilter, SafetyLimits
from lerobot_adamanip.util.errors import ConfigurationError, RobotError

DT = 1 / 30
STEP = LIMITS.speed * DT


@pytest.fixture
def anchored() -> SafetyFilter:
    safety = SafetyFilter(LIMITS)
    safety.anchor(START, 1.0)
    return safety


def ahead(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    return pose_vector(transform(START[:3, 3] + (x, y, z), START[:3, :3]), 1.0)


def test_the_first_target_is_the_measured_pose(anchored: SafetyFilter) -> None:
    assert (anchored.stream(ahead(), START, DT) == pose_vector(START, 1.0)).all()
    with pytest.raises(RobotError, match="not anchored"):
        SafetyFilter(LIMITS).stream(ahead(), START, DT)


@pytest.mark.parametrize(("measured", "opening"), [(-0.01, 0.0), (0.4, 0.4), (1.03, 1.0)])
def test_a_measured_opening_beyond_its_range_is_cut(measured: float, opening: float) -> None:
    assert SafetyFilter(LIMITS).anchor(START, measured)[9] == pytest.approx(opening)


def test_a_goal_is_approached_at_the_speed_and_not_past_the_lead(anchored: SafetyFilter) -> None:
    """The arm stands still, as if it were held: the target runs to the lead and waits there."""
    moved = anchored.stream(ahead(0.15, 0.2), START, DT)[:3] - START[:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(STEP, rel=1e-3)
    assert moved[1] / moved[0] == pytest.approx(4 / 3, rel=1e-3)
    anchored.anchor(START, 1.0)
    for _ in range(100):
        out = anchored.stream(ahead(0.2), START, DT)
    assert out[0] - START[0, 3] == pytest.approx(LIMITS.lead, abs=1e-5)
    arrived = transform(pose_from_vector(out)[0][:3, 3], START[:3, :3])
    out = anchored.stream(ahead(0.2), arrived, DT)
    assert out[0] - arrived[0, 3] == pytest.approx(STEP, rel=1e-3)


def test_rotation_is_limited_as_well(anchored: SafetyFilter) -> None:
    wanted = pose_vector(transform(START[:3, 3], START[:3, :3] @ rotation_about((0, 0, 1), 1.0)), 1.0)
    for count in range(1, 60):
        out = pose_from_vector(anchored.stream(wanted, START, DT))[0]
        turned = math.acos((np.trace(START[:3, :3].T @ out[:3, :3]) - 1) / 2)
        assert turned == pytest.approx(min(count * LIMITS.angular_speed * DT, LIMITS.angular_lead), abs=2e-3)


def test_a_wall_of_the_box_is_slid_along(anchored: SafetyFilter) -> None:
    """Pressing at the floor does not stop the motion beside it."""
    here = START
    for _ in range(200):
        out = anchored.stream(ahead(0.0, 0.2, -1.0), here, DT)
        here = pose_from_vector(out)[0]
    lower, _ = LIMITS.reduced_box(here[:3, :3])
    assert here[2, 3] == pytest.approx(lower[2], abs=1e-5)
    assert here[1, 3] == pytest.approx(0.2, abs=1e-5)
    assert lower[2] == pytest.approx(0.032)  # half as high as the flange of a hand that lies on its side


def test_an_arm_that_was_pushed_away_drags_its_target_along(anchored: SafetyFilter) -> None:
    pushed = transform(START[:3, 3] + (0.0, 0.3, 0.0), START[:3, :3])
    out = anchored.stream(ahead(), pushed, DT)
    assert np.linalg.norm(out[:3] - pushed[:3, 3]) <= LIMITS.lead
    assert np.linalg.norm(out[:3] - START[:3, 3]) > 0.25


@pytest.mark.parametrize(
    "wrong",
    [
        np.full(10, np.nan),
        np.zeros(10),
        np.zeros(3),
        np.zeros((10, 1)),
        np.r_[ahead()[:3], np.inf, ahead()[4:]],
        np.r_[ahead()[:3], ahead()[3:6], ahead()[3:6], 1.0],
        np.array(["a"] * 10),
    ],
)
def test_a_malformed_target_keeps_the_last_and_ten_are_an_error(anchored: SafetyFilter, wrong: np.ndarray) -> None:
    for _ in range(2):  # a good target forgives the malformed ones before it
        last = anchored.stream(ahead(0.003), START, DT)
        for _ in range(MAX_REFUSED - 1):
            assert (anchored.stream(wrong, START, DT) == last).all()
    with pytest.raises(RobotError, match="10 malformed targets in a row"):
        anchored.stream(wrong, START, DT)


def test_a_malformed_key_frame_is_no_motion_and_ten_are_an_error(anchored: SafetyFilter) -> None:
    (goal,) = anchored.keyframe(ahead(0.15), START)  # the arm stalls at once
    for _ in range(MAX_REFUSED - 1):
        assert anchored.keyframe(np.full(10, np.nan), START) == []
        assert anchored.last is not None
        assert anchored.last.tobytes() == goal.tobytes()
    with pytest.raises(RobotError, match="10 malformed targets in a row"):
        anchored.keyframe(np.full(10, np.nan), START)


def test_a_key_frame_goes_as_far_as_the_box(anchored: SafetyFilter) -> None:
    (out,) = anchored.keyframe(ahead(0.15, 0.2), START)
    assert (out == ahead(0.15, 0.2)).all()
    (out,) = anchored.keyframe(ahead(5.0, 0.2), START)
    _, upper = LIMITS.reduced_box(START[:3, :3])
    assert upper[0] - 1e-6 < out[0] <= upper[0]
    assert out[1:].tobytes() == ahead(5.0, 0.2)[1:].tobytes()


def test_the_hand_stays_in_the_box_all_the_way_of_a_key_frame(anchored: SafetyFilter) -> None:
    """1,000 goals at the box's sides, with turns, each from where the one before has led; however a turn is timed."""
    rng, here = np.random.default_rng(0), START
    lower, upper = np.array(LIMITS.box_lower), np.array(LIMITS.box_upper)
    outside, detours = 0.0, 0
    for number in range(1000):
        position = rng.uniform(lower, upper)
        side = number % 3
        position[side] = (lower, upper)[number // 3 % 2][side] + rng.normal() * 0.02
        turned = here[:3, :3] @ rotation_about(rng.normal(size=3), rng.uniform(0, math.pi))
        way = anchored.keyframe(pose_vector(transform(position, turned), rng.uniform()), here)
        detours += len(way) - 1
        for target in way:
            goal = pose_from_vector(target)[0]
            shares = np.linspace(0.0, 1.0, 60)
            rotations = straight_path(here, goal, shares)[:, :3, :3]
            for places in (shares, np.sqrt(shares), shares**2):
                positions = here[:3, 3] + places[:, None] * (goal[:3, 3] - here[:3, 3])
                corners = positions[:, None] + HAND @ rotations.transpose(0, 2, 1)
                outside = max(outside, float((lower - corners).max()), float((corners - upper).max()))
            here = goal
    assert outside < 1e-6
    assert detours > 500


def test_a_key_frame_turns_where_there_is_room_with_the_grip_it_had(anchored: SafetyFilter) -> None:
    """Level at the floor, rolled by a quarter turn and back to the floor: up, turned, down."""
    floor = pose_vector(transform((0.5, 0.0, 0.0), START[:3, :3]), 0.0)
    (low,) = anchored.keyframe(floor, START)
    here = pose_from_vector(low)[0]
    rolled = pose_vector(transform((0.5, 0.0, 0.0), START[:3, :3] @ rotation_about((0, 0, 1), math.pi / 2)), 1.0)
    lift, turn, end = anchored.keyframe(rolled, here)
    assert lift[2] > low[2] + 0.05
    assert lift[3:9].tobytes() == low[3:9].tobytes()
    assert turn[3:9].tobytes() == end[3:9].tobytes()
    assert turn[2] >= end[2]
    assert [float(each[9]) for each in (lift, turn, end)] == [0.0, 0.0, 1.0]
    assert anchored.last is not None
    assert anchored.last.tobytes() == end.tobytes()


def test_the_corners_contain_the_whole_hand() -> None:
    planes = ConvexHull(HAND_CORNERS).equations
    assert (HAND @ planes[:, :3].T + planes[:, 3]).max() <= 0.0
    page = (Path(__file__).parents[2] / "docs" / "robot.md").read_text(encoding="utf-8")
    assert f"each side is longer than {2 * MAX_REACH_M:.3f} m" in page


def test_a_hand_outside_the_box_is_no_place_to_begin() -> None:
    safety = SafetyFilter(LIMITS)
    with pytest.raises(RobotError, match="outside the box"):
        safety.anchor(transform((0.5, 0.0, -0.05), START[:3, :3]), 1.0)
    lower, _ = LIMITS.reduced_box(START[:3, :3])
    barely = transform((0.5, 0.0, lower[2] - 0.005), START[:3, :3])
    assert safety.anchor(barely, 1.0)[2] >= lower[2]


@pytest.mark.parametrize(
    "wrong", [{"box_upper": (0.3, 0.5, 0.7)}, {"box_lower": (0.2, 0.6, 0.0)}, {"speed": 0.0}, {"lead": math.nan}]
)
def test_limits_that_cannot_work_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        SafetyLimits(**{"box_lower": LIMITS.box_lower, "box_upper": LIMITS.box_upper, **wrong})  # type: ignore[arg-type]


finite = st.floats(-3, 3, width=32)


@given(arrays(np.float32, 10, elements=st.floats(width=32)), arrays(np.float64, 3, elements=finite), finite)
def test_the_laws_hold_for_any_ten_numbers(target: np.ndarray, away: np.ndarray, dt: float) -> None:
    safety = SafetyFilter(LIMITS)
    safety.anchor(START, 1.0)
    measured = transform(START[:3, 3] + away * 0.1, START[:3, :3])
    assert broken_laws(safety, target, measured, dt) == []


def test_the_laws_hold_along_a_random_session() -> None:
    found = fuzz(1500, seed=0)
    assert {name for name in found if name.startswith("broken")} == set()
    assert min(found.values()) > 100


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_the_laws_hold_for_two_hundred_thousand_targets() -> None:
    """Forty sessions of five thousand, from fresh seeds."""
    for seed in range(40):
        found = fuzz(5000, seed=1000 + seed)
        assert {name for name in found if name.startswith("broken")} == set(), seed
