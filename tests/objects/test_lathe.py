"""The lathe: frusta that follow a profile, and decoration that lies on it."""

from __future__ import annotations

import numpy as np
import pytest
from solids import contains, face_planes

from lerobot_adamanip.objects.base import Material
from lerobot_adamanip.objects.geometry.lathe import PROUD, Ring, decal, fluted, oval, patch, ring_at, turned
from lerobot_adamanip.objects.geometry.shapes import rotated

PLAIN = Material((0.5, 0.5, 0.5))
PROFILE = (Ring(0.0, 0.03), Ring(0.05, 0.04), Ring(0.05, 0.04), Ring(0.08, 0.01))


def test_what_is_turned_is_seen_in_slices_and_solid_inside_them() -> None:
    shapes = turned(PROFILE, PLAIN, axis=(0.1, 0.0))
    seen, solid = ([shape for shape in shapes if shape.collides == collides] for collides in (False, True))
    assert len(seen) == 2, "rings at one height have nothing between them"
    for height in (0.01, 0.03, 0.049, 0.06, 0.079):
        ring = ring_at(PROFILE, height)
        for angle in np.linspace(0, 2 * np.pi, 13):
            inside, outside = (
                (ring.point(angle) * np.array([scale, scale, 1]) + np.array([0.1, 0, 0]))[None] for scale in (0.9, 1.01)
            )
            for some in (seen, solid):
                assert any(contains(shape, inside)[0] for shape in some)
                assert not any(contains(shape, outside)[0] for shape in some)


def test_solids_stay_inside_a_hollow_profile_and_are_never_thin() -> None:
    rings = [Ring(0.001 * k, 0.03 - 0.01 * np.sin(np.pi * k / 60)) for k in range(61)]
    for shape in (shape for shape in turned(rings, PLAIN) if shape.collides):
        assert shape.vertices is not None
        assert len(shape.vertices) <= 64
        assert np.ptp(shape.vertices[:, 2]) >= 0.0089
        for height in np.linspace(0, 0.06, 13):
            edge = ring_at(rings, float(height)).point(np.linspace(0, 2 * np.pi, 33))
            assert not contains(shape, edge).any()
    assert not any(shape.collides for shape in turned((Ring(0.0, 0.02), Ring(0.002, 0.02)), PLAIN))


@pytest.mark.parametrize("squareness", [0.0, 0.5, 1.0])
def test_a_cross_section_keeps_its_width_and_depth(squareness: float) -> None:
    points = Ring(0.02, 0.04, 0.6, squareness).point(np.linspace(0, 2 * np.pi, 721))
    np.testing.assert_allclose(np.abs(points[:, 1]).max(), 0.04, rtol=0.02 if squareness else 1e-9)
    np.testing.assert_allclose(np.abs(points[:, 0]).max(), 0.024, rtol=0.02 if squareness else 1e-9)
    np.testing.assert_allclose(points[:, 2], 0.02)


def test_a_picture_lies_on_the_surface_and_faces_outward() -> None:
    profile = (Ring(0.0, 0.03), Ring(0.1, 0.04))
    for curves in (patch(0.05, 0.02, 0.07), oval(0.04, 0.03, 0.05), oval(0.04, 0.03, 0.05, sharp=True)):
        shape = decal(profile, curves, PLAIN, layer=2)
        assert not shape.collides
        assert shape.vertices is not None
        assert shape.faces is not None
        radius = np.hypot(shape.vertices[:, 0], shape.vertices[:, 1])
        expected = [ring_at(profile, float(z)).radius + 2 * PROUD for z in shape.vertices[:, 2]]
        np.testing.assert_allclose(radius, expected, atol=1e-6)
        corners = shape.vertices[shape.faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        normals, _ = face_planes(shape) if areas.min() > 0 else (None, None)
        if normals is not None:
            assert np.all(np.sum(normals[:, :2] * corners.mean(axis=1)[:, :2], axis=1) > 0)
        assert np.arctan2(shape.vertices[:, 1], shape.vertices[:, 0]).mean() == pytest.approx(0.0, abs=1e-3)


def test_ribs_are_decoration_around_a_radius() -> None:
    shape = fluted(0.0, 0.02, 0.015, 24, PLAIN, groove=0.001, taper=0.9)
    assert not shape.collides
    assert shape.vertices is not None
    lower = shape.vertices[shape.vertices[:, 2] == 0.0]
    radii = np.unique(np.round(np.hypot(lower[:, 0], lower[:, 1]), 6))
    np.testing.assert_allclose(radii, [0.014, 0.015], atol=1e-6)


def test_rotated_shapes_turn_about_the_link_s_axis() -> None:
    made = turned((Ring(0.0, 0.01), Ring(0.02, 0.01)), PLAIN, axis=(0.05, 0.0), collides=False)
    (shape,) = rotated(made, (0.0, 0.0, 1.0), np.pi / 2)
    np.testing.assert_allclose(shape.pose_in_link[:3, 3], [0.0, 0.05, 0.01], atol=1e-12)
