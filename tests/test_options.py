"""The one object that says which environment it is."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError

GIVEN = EnvironmentOptions(
    category="lamp",
    objects="0:2",
    num_points=64,
    poses="fixed",
    hidden_overrides={"mode": 1},
    split="validation",
    workspace=Workspace((0.2, -0.5, 0.4), (0.9, 0.5, 1.2)),
)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda given: pickle.loads(pickle.dumps(given))])
def test_copies_are_equal(copied: Any) -> None:
    again = copied(GIVEN)
    assert again == GIVEN
    with pytest.raises(TypeError):
        again.hidden_overrides["mode"] = 2


def test_what_was_given_cannot_be_changed_from_outside() -> None:
    overrides = {"mode": 1}
    options = EnvironmentOptions(category="lamp", hidden_overrides=overrides)
    overrides["mode"] = 2
    assert options.hidden_overrides == {"mode": 1}


def test_a_change_makes_a_checked_copy() -> None:
    assert GIVEN.changed(num_points=32).num_points == 32
    assert GIVEN.num_points == 64
    with pytest.raises(ConfigurationError, match="num_point"):
        GIVEN.changed(num_point=32)
    with pytest.raises(ConfigurationError):
        GIVEN.changed(num_points=0)


def test_equal_values_of_other_types_become_the_annotated_ones() -> None:
    options = GIVEN.changed(num_points=np.int64(32), hints=1, cameras=["front"], logged_seeds=[5, np.int32(6)])
    assert (options.num_points, options.hints, options.cameras, options.logged_seeds) == (32, 1.0, ("front",), (5, 6))
    assert json.loads(json.dumps(options.to_json()))["num_points"] == 32
    plain = EnvironmentOptions(hidden_overrides={"locked": np.True_, "direction": np.int64(-1)}).to_json()
    assert json.loads(json.dumps(plain))["hidden_overrides"] == {"locked": True, "direction": -1}
    assert options.changed(assets=None, episode_log=Path("log.jsonl")).episode_log == "log.jsonl"


def test_a_change_to_key_frames_resets_what_they_do_not_read() -> None:
    dense = GIVEN.changed(control="dense", action="joint", state="full", fps=25, max_steps=9)
    assert dense.changed(control="keyframe") == GIVEN
    with pytest.raises(ConfigurationError, match="fps has no effect"):
        dense.changed(control="keyframe", fps=25)


def test_json_holds_every_option() -> None:
    told = json.loads(json.dumps(GIVEN.to_json()))
    assert set(told) == set(EnvironmentOptions.__dataclass_fields__)
    assert told["hidden_overrides"] == {"mode": 1}
    assert told["workspace"]["upper"] == [0.9, 0.5, 1.2]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"category": "fridge"}, "fridge"),
        ({"objects": "9:3"}, "9:3"),
        ({"num_points": -1}, "-1"),
        ({"image_size": 8}, "16 ... 2048"),
        ({"image_size": 33}, "even"),  # no video has an odd size
        ({"poses": "paper"}, "fixed, randomized"),
        ({"mechanism_rules": "mine"}, "mine"),
        ({"max_key_frames": 0}, "key frames"),
        ({"max_failed_tries": -1}, "or best"),
        ({"max_failed_tries": "few"}, "'few'"),
        ({"split": "dev"}, "validation"),
        ({"hidden_overrides": {"direction": 5}}, "-1 or 1"),
        ({"hidden_overrides": {"mode": 1}}, "locked, direction, knob_range"),
        ({"hidden_overrides": {"locked": True}, "mechanism_rules": "row"}, "second_pulls"),
        ({"seed_offset": -1}, "seed offset"),
        ({"render_backend": "gpu"}, "auto, cpu, cuda"),
        ({"sensing": "d453"}, "--env.sensing=d435"),
        ({"sensing": "d435", "cloud_source": "render"}, "cloud_source raycast"),
        ({"workspace": Workspace((0.5, 0.0, 0.0), (0.5, 1.0, 1.0))}, "workspace"),
        ({"workspace": Workspace(upper=(0.8, 0.4, float("inf")))}, "within 10 m"),  # no manifest holds it
        # Without effect.
        ({"action": "joint"}, "--env.control=dense"),
        ({"fps": 25}, "--env.control=dense"),
        ({"control": "dense", "self_calibration": True}, "--env.observe_cloud=true"),
        ({"control": "dense", "sensing": "exact,lost=0.1"}, "change clouds alone"),
        ({"control": "dense", "sensing": "exact,latency_ms=40"}, "change clouds alone"),  # no picture is a step late
        ({"control": "dense", "sensing": "d435", "observe_images": False}, "change clouds alone"),
        # Of another type than annotated: Python checks none, and text is true, or a list of letters.
        ({"observe_images": "false"}, "bool | None"),
        ({"self_calibration": "false"}, "self_calibration=False"),
        ({"observe_cloud": 1, "control": "dense"}, "1 (int)"),
        ({"category": ["safe"]}, "category='safe'"),
        ({"split": None}, "None (NoneType)"),
        ({"num_points": "64"}, "'64' (str)"),
        ({"num_points": 64.0}, "64.0 (float)"),
        ({"repeats": True}, "True (bool)"),
        ({"hints": "0.5"}, "'0.5' (str)"),
        ({"cameras": "front"}, "'front' (str)"),
        ({"cameras": []}, "--env.observe_images=false"),  # none is not all
        ({"objects": "safe_000,safe_001,safe_000"}, "each once"),
        ({"episode_log": ""}, "not a file's path"),
        ({"episode_log": "."}, "not a file's path"),  # a folder
        ({"assets": "x" * 5000}, "does not exist"),
        ({"max_failed_tries": "9" * 5000}, "0 ... 1000"),
        ({"hints": 10**400}, "float"),
        ({"workspace": {1: 2}}, "lower, upper"),
        ({"hidden_overrides": {1: 2}}, "locked, direction, knob_range"),
        ({"hidden_overrides": {("locked",): True, "mode": 1}}, "('locked',), mode"),
        ({"hidden_overrides": {"locked": np.array([True, False])}}, "array([ True, False])"),
        ({"hidden_overrides": {"knob_range": float("nan")}}, "above 0"),
        ({"hidden_overrides": {"knob_range": -1.0}}, "above 0"),
        ({"hidden_overrides": {"wrong": 0.5}}, "locked, direction, knob_range"),
        ({"hidden_overrides": {"direction": 0.5}}, "-1 or 1"),
        ({"hidden_overrides": "locked"}, "Mapping[str, Any]"),
        ({"logged_seeds": (5,)}, "tuple[int, int] | None"),
        ({"logged_seeds": (5, 6, 2)}, "tuple[int, int] | None"),
        ({"workspace": {"lower": (0.0, 0.0)}}, "tuple[float, float, float]"),
        ({"workspace": ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))}, "Workspace"),
        ({"sensing": "d435," + ",".join(["lost=0.1"] * 50)}, "at most 400 characters"),
    ],
)
def test_what_cannot_work_is_one_clear_error(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:") as caught:
        EnvironmentOptions(**wrong)
    assert said in str(caught.value)


def test_pictures_show_errors_of_the_camera_without_a_cloud() -> None:
    for sensing, fps in (("exact,camera_error_mm=20", 10), ("d435", 5), ("exact,latency_ms=100", 10)):
        options = EnvironmentOptions(category="safe", control="dense", sensing=sensing, fps=fps)
        assert not options.observes_cloud
