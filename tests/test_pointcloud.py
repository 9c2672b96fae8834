"""Clouds: the crop, and an order of which every prefix is itself a farthest-point sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_adamanip.contract.pointcloud import Workspace, as_points, check_num_points, farthest_point_order
from lerobot_adamanip.util.errors import ConfigurationError

fast = settings(max_examples=30, deadline=None)
seeds = st.integers(0, 2**31)


def cloud(size: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (size, 3)).astype(np.float32)


def rows(points: np.ndarray) -> set[tuple[float, ...]]:
    return set(map(tuple, points.tolist()))


@fast
@given(seeds, st.integers(2, 800), st.data())
def test_a_prefix_of_a_sample_is_the_smaller_sample(seed: int, size: int, data: st.DataObject) -> None:
    points = cloud(size, seed)
    many = data.draw(st.integers(1, size))
    few = data.draw(st.integers(1, many))
    assert np.array_equal(farthest_point_order(points, many)[:few], farthest_point_order(points, few))


@fast
@given(seeds, st.integers(2, 400))
def test_each_point_is_the_farthest_from_those_before_it(seed: int, size: int) -> None:
    points = cloud(size, seed)
    sample = farthest_point_order(points, min(size, 40)).astype(np.float64)
    nearest = np.linalg.norm(points - sample[0], axis=1)
    for chosen in sample[1:]:
        index = np.flatnonzero((points == chosen).all(1))[0]
        assert nearest[index] >= nearest.max() - 1e-5
        nearest = np.minimum(nearest, np.linalg.norm(points - chosen, axis=1))


@fast
@given(seeds, st.integers(1, 300), st.integers(1, 500))
def test_a_sample_is_of_the_cloud_s_own_points_each_once(seed: int, size: int, wanted: int) -> None:
    points = cloud(size, seed)
    sample = farthest_point_order(points, wanted)
    assert sample.shape == (wanted, 3)
    assert sample.dtype == np.float32
    assert rows(sample) <= rows(points)
    assert len(rows(sample)) == min(size, wanted)


@fast
@given(seeds, st.integers(1, 60), st.integers(1, 400))
def test_a_cloud_of_too_few_points_is_repeated_from_its_start(seed: int, size: int, wanted: int) -> None:
    sample = farthest_point_order(cloud(size, seed), wanted)
    for start in range(size, wanted, size):
        part = sample[start : start + size]
        assert np.array_equal(part, sample[: len(part)])


def test_equal_clouds_give_equal_samples_and_stay_as_they_are() -> None:
    points = cloud(5000)
    before = points.copy()
    first = farthest_point_order(points, 512)
    np.random.default_rng(1).random(100)
    assert np.array_equal(first, farthest_point_order(points.copy(), 512))
    assert np.array_equal(points, before)
    first[:] = 0
    assert np.array_equal(points, before), "a sample is no view of the cloud"


@pytest.mark.parametrize("size", [1, 2, 33, 700])
def test_points_that_coincide_are_no_obstacle(size: int) -> None:
    same = np.full((size, 3), 0.5, np.float32)
    assert np.array_equal(farthest_point_order(same, 64), np.full((64, 3), 0.5))


@pytest.mark.parametrize("wanted", [1, 7, 4096])
def test_a_camera_that_sees_nothing_gives_zeros(wanted: int) -> None:
    empty = farthest_point_order(np.zeros((0, 3), np.float32), wanted)
    assert empty.shape == (wanted, 3)
    assert empty.dtype == np.float32
    assert not empty.any()


@pytest.mark.parametrize("like", [np.asarray, torch.from_numpy])
@pytest.mark.parametrize("batch", [(), (2,), (2, 3), (0,)])
def test_points_of_a_column_are_the_cloud_again(like: Callable[[Any], Any], batch: tuple[int, ...]) -> None:
    points = np.random.default_rng(0).normal(size=(*batch, 7, 3)).astype(np.float32)
    given, found = like(points), as_points(like(points.reshape(*batch, 21)))
    assert type(found) is type(given)
    assert found.shape == given.shape
    assert (found == given).all()
    assert as_points(given) is given


def test_numbers_that_are_no_points_are_one_clear_error() -> None:
    with pytest.raises(ConfigurationError, match=r"(?s)\(2, 20\).*3 N"):
        as_points(np.zeros((2, 20)))


@pytest.mark.parametrize("wanted", [0, -1, 16_385])
def test_an_impossible_number_of_points_is_refused(wanted: int) -> None:
    with pytest.raises(ConfigurationError, match=r"1 \.\.\. 16384"):
        farthest_point_order(cloud(10), wanted)
    with pytest.raises(ConfigurationError, match=str(wanted)):
        check_num_points(wanted)


def test_a_column_holds_two_points_or_more() -> None:
    """As 3 numbers a single point could not be told from points (N, 3)."""
    with pytest.raises(ConfigurationError, match=r"2 \.\.\. 16384"):
        check_num_points(1)
    for batch in (2, 3, 7):
        flat = np.arange(batch * 6, dtype=np.float32).reshape(batch, 6)
        assert as_points(flat).shape == (batch, check_num_points(2), 3)


@fast
@given(seeds)
def test_the_crop_keeps_exactly_what_lies_in_the_box(seed: int) -> None:
    box = Workspace((-0.5, -0.2, 0.0), (0.5, 0.7, 0.4))
    points = cloud(200, seed)
    expected = [all(lo <= c <= up for lo, c, up in zip(box.lower, p, box.upper, strict=True)) for p in points.tolist()]
    assert box.contains(points).tolist() == expected


def test_the_box_is_closed_and_what_is_no_number_lies_outside() -> None:
    box = Workspace((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    corners = np.array([box.lower, box.upper], np.float32)
    assert box.contains(corners).all()
    assert not box.contains(np.nextafter(corners, np.array([[-9], [9]], np.float32))).any()
    assert not box.contains(np.array([[np.nan, 0.3, 0.4], [np.inf, 0.3, 0.4]], np.float32)).any()
    assert box.contains(np.zeros((0, 3), np.float32)).shape == (0,)
