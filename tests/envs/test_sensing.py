"""Sensor errors in the simulator: they change what is observed, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from envs_helpers import SMALL, digest
from scipy.spatial import cKDTree

from lerobot_adamanip.contract.sensing import LEVELS
from lerobot_adamanip.experts import Phase, make_expert
from lerobot_adamanip.hardware.calibration.hand_shape import franka_hand
from lerobot_adamanip.hardware.camera_frames import simulated_calibration
from lerobot_adamanip.hardware.depth_cloud import points_in_base
from lerobot_env_adamanip.dense_env import DenseEnv
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim.hand_surface import hand_surface

pytestmark = pytest.mark.sim
SHIFTED = "exact,camera_error_mm=20"


@pytest.fixture(scope="module")
def envs() -> Iterator[dict[str, KeyframeEnv]]:
    made = {level: KeyframeEnv("safe", **SMALL, observe_images=False, sensing=level) for level in (*LEVELS, SHIFTED)}
    yield made
    for env in made.values():
        env.close()


def until_held(env: KeyframeEnv, seed: int, **hidden: Any) -> list[dict[str, Any]]:
    """Observations up to the grasp, with the positions of all joints."""
    observation, _ = env.reset(seed=seed, options={"hidden_overrides": hidden})
    seen = [{**observation, "joints": env.joints()}]
    expert = make_expert("safe", "adaptive", env.annotations, generator=np.random.default_rng(0))
    goal = next(expert)
    while goal.phase in (Phase.APPROACH, Phase.GRASP):
        observation = env.step(goal.action())[0]
        seen.append({**observation, "joints": env.joints()})
        goal = expert.send(env.feedback)
    return seen


@pytest.mark.parametrize("level", LEVELS)
def test_equal_seeds_are_equal_and_hidden_states_look_alike_until_a_try(envs: Any, level: str) -> None:
    locked, unlocked = (until_held(envs[level], 31, locked=value) for value in (True, False))
    assert len(locked) >= 4
    assert [digest(one) for one in locked] == [digest(one) for one in unlocked]
    other = until_held(envs[level], 32, locked=True)
    assert digest(other[0]) != digest(locked[0])


@pytest.mark.parametrize("level", [*list(LEVELS)[1:], SHIFTED])
def test_scene_hidden_state_and_physics_are_those_of_exact_sensors(envs: Any, level: str) -> None:
    exact, worse = until_held(envs["exact"], 33), until_held(envs[level], 33)
    assert envs["exact"].hidden_state() == envs[level].hidden_state()
    for one, other in zip(exact, worse, strict=True):
        np.testing.assert_array_equal(one["joints"], other["joints"])
        np.testing.assert_array_equal(one["agent_pos"], other["agent_pos"])
        assert not np.array_equal(one["point_cloud"], other["point_cloud"])
        assert envs[level].observation_space["point_cloud"].contains(other["point_cloud"])
    efforts = [[one["effort"] for one in seen] for seen in (exact, worse)]
    assert np.array_equal(*efforts) == (level == SHIFTED)


def test_exact_sensors_have_no_errors_to_draw(envs: Any) -> None:
    envs["exact"].reset(seed=0)
    assert envs["exact"].episode.task.errors is None
    assert envs["exact"].episode.task.cameras.errors is None


def distances(points: Any, others: Any) -> Any:
    return np.linalg.norm(points - others[cKDTree(others).query(points)[1]], axis=1)


def test_depth_and_cloud_are_reported_from_the_same_wrong_place(envs: Any) -> None:
    cameras = {}
    for level in ("exact", SHIFTED):
        envs[level].reset(seed=5)
        cameras[level] = envs[level].episode.task.cameras
    cloud = cameras[SHIFTED].points()
    _, depth = cameras[SHIFTED].color_and_depth("raycast")
    from_depth = points_in_base(depth, simulated_calibration(cameras[SHIFTED].parameters()))
    from_depth = from_depth[envs["exact"].workspace.contains(from_depth)]
    assert np.median(distances(from_depth, cloud)) < 2e-3
    shift = cameras[SHIFTED].errors.camera[:3, 3]
    assert np.linalg.norm(shift) == pytest.approx(0.02)
    assert np.median(distances(cloud - shift.astype(np.float32), cameras["exact"].points())) < 2e-3
    assert np.median(distances(cloud, cameras["exact"].points())) > 5e-3
    moved, still = (cameras[level].view("wrist").pose for level in (SHIFTED, "exact"))
    assert np.linalg.norm(moved[:3, 3] - still[:3, 3]) == pytest.approx(0.02, rel=1e-3)
    reported, nominal = (cameras[level].parameters()["extrinsics"] for level in (SHIFTED, "exact"))
    assert np.array(reported) == pytest.approx(np.array(nominal), abs=1e-6), "nobody knows of the error"


@pytest.mark.parametrize(("level", "least", "most"), [("d435", 0.03, 0.2), ("rough", 0.15, 0.4)])
def test_points_are_lost_and_noisy_as_with_such_a_camera(envs: Any, level: str, least: float, most: float) -> None:
    counts, errors = [], []
    for seed in range(3):
        points = []
        for name in ("exact", level):
            envs[name].reset(seed=seed)
            points.append(envs[name].episode.task.cameras.points())
        reported = envs[level].episode.task.errors
        tool = envs[level].episode.task.cameras.tcp_in_base
        true = np.linalg.inv(tool @ reported.arm @ np.linalg.inv(tool) @ reported.camera)
        measured = points[1] @ true[:3, :3].T + true[:3, 3]
        inside = [envs[level].workspace.contains(one).sum() for one in (points[0], measured)]
        counts.append(1 - inside[1] / inside[0])
        errors.append(np.median(distances(measured, points[0])))
    assert least < np.mean(counts) < most
    assert 1e-3 < np.mean(errors) < 6e-3


def test_a_cloud_drops_flying_points_as_the_arms_does(envs: Any) -> None:
    env = envs["rough"]
    env.reset(seed=41)
    cameras = env.episode.task.cameras
    surface = cKDTree(cameras.rays.points())
    measured, kept = (cameras.rays.points(part) for part in (cameras.errors.depths, cameras.errors.cloud_depths))
    flying = [int((surface.query(points)[0] > 0.03).sum()) for points in (measured, kept)]
    assert flying[0] >= 5
    assert flying[1] == 0
    assert len(kept) > 0.95 * len(measured)
    assert len(cameras.points()) == len(kept)


def test_clouds_and_images_come_late_in_dense_control() -> None:
    late, now = (
        DenseEnv("safe", **SMALL, observe_cloud=True, cameras=("front",), sensing=f"exact,latency_ms={value}")
        for value in (100, 40)
    )
    seen: dict[Any, list[Any]] = {late: [], now: []}
    try:
        for env, several in seen.items():
            several.append(env.reset(seed=1)[0])
            goal = env.feedback.tcp_in_base.copy()
            goal[2, 3] += 0.1
            for _ in range(2):
                several.append(env.step(env.action_toward(goal, 1.0))[0])
        for key in ("point_cloud", "agent_pos"):
            same = [np.array_equal(one[key], other[key]) for one, other in zip(*seen.values(), strict=True)]
            assert same == [True, key == "agent_pos", key == "agent_pos"], key
        for step in (0, 1):
            np.testing.assert_array_equal(seen[late][step + 1]["point_cloud"], seen[now][step]["point_cloud"])
            np.testing.assert_array_equal(seen[late][step + 1]["pixels"]["front"], seen[now][step]["pixels"]["front"])
        kept = late.observe()
        for value in (kept["point_cloud"], kept["pixels"]["front"]):
            value[:] = 0  # by a caller, whose they are
        assert late.observe()["point_cloud"].any()
        assert late.render().any()
        moved = late.observe()["pixels"]["front"]
        late.restart_episode()  # for a late start: nothing was seen before
        first = late.observe()["pixels"]["front"]
        np.testing.assert_array_equal(first, now.observe()["pixels"]["front"])
        assert not np.array_equal(first, moved)
    finally:
        late.close()
        now.close()


# Self-calibration -----------------------------------------------------------------------------------------------------


def off(env: KeyframeEnv) -> float:
    """Mean distance of corrected points to true ones in the workspace, after the errors of camera and arm [m]."""
    cameras, workspace = env.episode.task.cameras, env.workspace
    points = np.random.default_rng(0).uniform(workspace.lower, workspace.upper, (200, 3))
    error = np.eye(4) if cameras.errors is None else cameras.errors.camera
    motion = cameras.calibration.correction @ error
    return float(np.linalg.norm(points @ motion[:3, :3].T + motion[:3, 3] - points, axis=1).mean())


@pytest.mark.parametrize(
    ("sensing", "most"),
    [("exact", 1.5e-3), ("exact,camera_error_mm=30,camera_error_deg=3", 2e-3), ("d435,arm_error_mm=0", 3e-3)],
)
def test_clouds_are_corrected_by_the_hand_in_them(sensing: str, most: float) -> None:
    env = KeyframeEnv("safe", **SMALL, observe_images=False, sensing=sensing, self_calibration=True)
    try:
        for seed in (3, 4):
            seen = until_held(env, seed, locked=True)
            assert len(seen) >= 4
            assert off(env) < most
            assert env.episode.record().self_calibration
            assert env.episode.task.cameras.calibration.frames >= 3
            again = until_held(env, seed, locked=False)
            assert [digest(one) for one in seen] == [digest(one) for one in again]
    finally:
        env.close()


def test_the_real_hands_description_is_that_of_the_simulated_hand(envs: Any) -> None:
    envs["exact"].reset(seed=0)
    cameras = envs["exact"].episode.task.cameras
    mesh, parts = hand_surface(cameras.robot, cameras.urdf), franka_hand()
    for gripper in (0.0, 1.0):
        points, (surface, normals) = mesh.at(gripper)[0], parts.at(gripper)
        nearest = cKDTree(surface).query(points)[1]
        away = np.abs(((points - surface[nearest]) * normals[nearest]).sum(1))
        assert np.median(away) < 1e-3
    outside = np.einsum("ij,ij->i", *(part - part.mean(0) for part in mesh.at(1.0)))
    assert (outside > 0).mean() > 0.8, "normals point outward"
