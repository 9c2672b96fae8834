"""The table of features: names, shapes, and the statistics that keep a constant dimension from exploding."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.rotations import pose_vector, transform

POSES = [schema.ACTION, schema.STATE]
DIMS = {schema.ACTION: 10, schema.STATE: 24}


def statistics(dims: dict[str, int], seed: int = 0) -> dict[str, dict[str, np.ndarray]]:
    rng = np.random.default_rng(seed)
    names = ("min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99")
    return {key: {**{n: rng.normal(size=d) for n in names}, "count": np.array([7])} for key, d in dims.items()}


def test_every_named_dimension_has_one_name() -> None:
    for feature in schema.dataset_features().values():
        if feature["names"] is not None and feature["dtype"] == "float32":
            assert (len(set(feature["names"])),) == feature["shape"]


def test_the_action_is_named_like_the_first_part_of_the_state() -> None:
    features = schema.dataset_features()
    assert features[schema.STATE]["names"][:10] == features[schema.ACTION]["names"]


def test_names_are_such_as_lerobot_rollout_keeps() -> None:
    assert all(name.endswith((".pos", ".vel")) for name in (*schema.STATE_NAMES, *schema.POSE_NAMES))


def test_named_slices_point_at_what_they_are_called() -> None:
    names = schema.POSE_NAMES
    assert all(name.startswith("ee.") and "r6d" not in name for name in names[schema.POSITION_DIMS])
    assert all("r6d" in name for name in names[schema.ROTATION_DIMS])
    assert names[schema.GRIPPER_DIM].startswith("gripper")
    vector = pose_vector(transform((1.0, 2.0, 3.0)), 0.25)
    assert vector.shape == (schema.ACTION_DIM,)
    assert vector[schema.POSITION_DIMS].tolist() == [1.0, 2.0, 3.0]
    assert vector[schema.ROTATION_DIMS].tolist() == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    assert vector[schema.GRIPPER_DIM] == 0.25


def test_lerobot_makes_no_label_an_input() -> None:
    from lerobot.utils.feature_utils import dataset_to_policy_features

    found = dataset_to_policy_features(schema.dataset_features())
    assert set(found) == {schema.POINT_CLOUD, schema.STATE, schema.EFFORT, schema.FRONT_IMAGE, schema.ACTION}


@pytest.mark.parametrize("key", POSES)
def test_rotation_and_gripper_get_their_true_range_and_nothing_else_changes(key: str) -> None:
    stats = statistics(DIMS)
    fixed = schema.fix_pose_statistics(stats)
    others = [*range(3), *range(10, DIMS[key])]
    lower, middle = dict.fromkeys(("min", "q01", "q10"), -1.0), dict.fromkeys(("mean", "q50"), 0.0)
    upper = dict.fromkeys(("max", "q90", "q99", "std"), 1.0)
    for name, value in {**lower, **middle, **upper}.items():
        assert np.all(fixed[key][name][3:10] == value)
        assert np.array_equal(fixed[key][name][others], stats[key][name][others])
    assert fixed[key]["count"] is stats[key]["count"]


def test_fixing_statistics_changes_no_argument_and_nothing_the_second_time() -> None:
    stats = statistics(DIMS)
    before = copy.deepcopy(stats)
    fixed = schema.fix_pose_statistics(stats)
    np.testing.assert_equal(stats, before)
    np.testing.assert_equal(schema.fix_pose_statistics(fixed), fixed)


def test_statistics_of_other_features_or_of_none_pass_through() -> None:
    stats = statistics({schema.EFFORT: 7})
    np.testing.assert_equal(schema.fix_pose_statistics(stats), stats)
    assert schema.fix_pose_statistics({}) == {}
    only_mean = {schema.STATE: {"mean": np.ones(24)}}
    assert set(schema.fix_pose_statistics(only_mean)[schema.STATE]) == {"mean"}
