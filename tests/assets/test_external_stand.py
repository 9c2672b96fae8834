"""External assets keep their real size: where they stand before the arm, and that it opens a door of full size."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asset_folders import adamanip_safe, full_size_door, partnet_safe, safe_annotation

from lerobot_adamanip.assets import load_object
from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.contract.pointcloud import DEFAULT_WORKSPACE
from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.sim.placement import ExternalStand, ReachRequirement, external_stand, generated_stand

PULL = (ReachRequirement("lever", ({"lever": 1.0}, {"lever": 1.0, "leaf": 0.77})),)
RULE = ExternalStand(wide_farthest={"leaf": 0.5})


@pytest.mark.parametrize(("width", "lever"), [(0.9, 1.0), (0.75, 1.1), (0.85, 0.8)])
def test_a_full_size_door_stands_where_its_lever_is_at_hand_and_in_the_cloud(
    tmp_path: Path, width: float, lever: float
) -> None:
    door = load_object(full_size_door(tmp_path / "big", width, 2.0, lever), "door")
    assert door.size[2] > 2.0, "its real size"
    stand = external_stand(door, PULL, RULE, nominal_x=0.66, part_height=0.72)
    turned = np.diag([-1.0, -1.0, 1.0])
    grip = np.array([stand.x, stand.y, stand.floor_z]) + turned @ door.part("lever").grasp[:3, 3]
    assert grip[2] == pytest.approx(0.72)
    assert abs(grip[1]) == pytest.approx(RULE.wide_y)
    assert stand.ground_z == stand.floor_z < 0
    opened = door.part("lever").moved({"leaf": 0.5})[:3, 3]
    end = np.array([stand.x, stand.y, stand.floor_z]) + turned @ opened
    assert end[0] < grip[0] - 0.25, "it comes towards the robot"
    assert abs(end[1]) < 0.2, "and not past it"
    assert DEFAULT_WORKSPACE.contains(np.array([grip, end], np.float32)).all()
    assert stand.reaches[0].paths[0][1] == {"lever": 1.0, "leaf": 0.5}


def test_small_assets_and_generated_objects_stand_as_they_did(tmp_path: Path) -> None:
    door = make_object("door_003")
    stand = generated_stand(door, PULL, nominal_x=0.66, part_height=0.72)
    assert (stand.x, stand.y, stand.reaches) == (0.66, 0.0, PULL)
    assert stand.floor_z == pytest.approx(0.72 - door.part("lever").grasp[2, 3])
    safe = load_object(adamanip_safe(tmp_path / "sa1"), "safe")
    reaches = (ReachRequirement("handle", ({"door": 0.77},)),)
    stand = external_stand(safe, reaches, RULE, nominal_x=0.66, part_height=0.72)
    assert (stand.x, stand.y) == (0.66, 0.0)
    assert [(each.part, each.paths) for each in stand.reaches] == [("handle", (({"door": 0.77},),))]
    far = replace(RULE, part_y=0.05)
    shifted = external_stand(safe, reaches, far, nominal_x=0.66, part_height=0.72)
    assert shifted.y == pytest.approx(0.05 - 0.08), "the handle, 8 cm aside, is brought within 5 cm"


@pytest.fixture
def full_size(tmp_path: Path) -> Iterator[Any]:
    """An environment with a door of 0.9 x 2.0 m."""
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    full_size_door(tmp_path / "door" / "big")
    env = KeyframeEnv("door", objects="door:big", assets=str(tmp_path), observe_images=False, num_points=512)
    yield env
    env.close()


def _opens(env: Any, seed: int, observation: Any) -> bool:
    expert = make_expert("door", "adaptive", env.annotations, generator=np.random.default_rng(seed))
    return rollout(env, observation, expert).success


@pytest.mark.sim
def test_the_adaptive_expert_opens_a_full_size_door_and_the_camera_sees_what_it_holds(full_size: Any) -> None:
    observation, _ = full_size.reset(seed=1)
    lever = full_size.annotations["lever"].grasp[:3, 3]
    near = np.linalg.norm(observation["point_cloud"] - lever, axis=1) < 0.10
    assert near.sum() >= 5
    assert _opens(full_size, 1, observation)


@pytest.mark.sim
@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_full_size_doors_are_opened_unless_their_lever_turns_far(full_size: Any) -> None:
    """It was 16 of 20: of six levers that turn to the arm's side by more than 0.88 rad, four were not opened."""
    opened, far = [], []
    for seed in range(100, 120):
        observation, _ = full_size.reset(seed=seed)
        hidden = full_size.episode_record()["hidden_state"]
        (opened if _opens(full_size, seed, observation) else far).append((hidden["direction"], hidden["turn_range"]))
    assert len(opened) >= 16
    assert all(way == -1 and turn > 0.88 for way, turn in far), far


def out_of_reach(folder: Path) -> Path:
    """A safe whose handle is held from behind, where the arm does not come."""
    partnet_safe(folder)
    content = safe_annotation()
    grasp = np.array(content["parts"]["handle"]["grasp"])
    grasp[:3, :3] = np.diag([-1.0, -1.0, 1.0]) @ grasp[:3, :3]
    content["parts"]["handle"]["grasp"] = grasp.tolist()
    (folder / "adamanip.json").write_text(json.dumps(content))
    return folder


@pytest.mark.sim
def test_one_asset_out_of_reach_is_left_out_by_name_and_costs_no_other(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    from lerobot_adamanip.cli.collect_setup import select_placeable
    from lerobot_adamanip.cli.objects import checked_source
    from lerobot_adamanip.util.errors import ConfigurationError, UnreachableError
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    adamanip_safe(tmp_path / "safe" / "near")
    far = [out_of_reach(tmp_path / "safe" / f"far{number}").name for number in range(3)]
    reports = {each.asset_id: each.problem for each in checked_source(tmp_path).check("safe")}
    assert reports["safe:near"] == ""
    assert all("does not reach its handle" in reports[f"safe:{name}"] for name in far)
    assert select_placeable(["safe"], "all", tmp_path, "randomized") == ("safe:near",)
    (told,) = [each.getMessage() for each in caplog.records if "3 of 4" in each.getMessage()]
    assert all(f"safe:{name}" in told for name in far)

    # Named ones are kept: whichever of them the simulator draws when it is made, it starts.
    named = ",".join(reports)
    for objects in ("all", named):
        env = KeyframeEnv("safe", objects=objects, assets=str(tmp_path), observe_images=False, num_points=512)
        try:
            for seed in range(2):
                env.reset(seed=seed, options={"object_id": "safe:near"})
                assert env.episode_record()["object_id"] == "safe:near"
            if objects == "all":
                env.reset(seed=0)
                assert env.episode_record()["object_id"] == "safe:near"
            with pytest.raises(UnreachableError, match="safe:far0"):
                env.reset(seed=0, options={"object_id": "safe:far0"})
        finally:
            env.close()
    with pytest.raises(ConfigurationError, match="can be used"):
        select_placeable(["safe"], "0:3", tmp_path, "randomized")
