"""External assets, in the layouts of AdaManip, UniDoorManip and PartNet-Mobility, become objects like ours."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from asset_folders import (
    adamanip_bottle,
    adamanip_safe,
    annotated,
    partnet_safe,
    safe_annotation,
    unidoormanip_door,
    write_box,
)
from solids import face_planes, solid

from lerobot_adamanip.assets import AssetSource, is_asset_id, load_object
from lerobot_adamanip.assets.annotation.session import Draft
from lerobot_adamanip.assets.meshes import Surface, convex_cache_folder, convex_parts
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.mechanisms import infeasible
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.util.errors import ConfigurationError


def closing(obj: ArticulatedObject, part: str) -> np.ndarray:
    return np.abs(obj.part(part).grasp[:3, 1])


def test_adamanip_s_safe_gets_our_frame_and_names(tmp_path: Path) -> None:
    safe = load_object(adamanip_safe(tmp_path / "sa1"), "safe")
    assert safe.object_id == "safe:sa1"
    assert [joint.name for link in safe.links if (joint := link.joint)] == ["door", "knob"], "the third is frozen"
    np.testing.assert_allclose(safe.size, (0.30, 0.35, 0.40), atol=1e-6)
    door, knob = safe.joint("door"), safe.joint("knob")
    # Hinge to the left of who stands behind the object, at its front's edge, at half its height.
    np.testing.assert_allclose(door.origin, (0.0, 0.14, 0.20), atol=1e-9)
    np.testing.assert_allclose(door.axis, (0, 0, 1), atol=1e-9)
    assert door.limits == (0.0, 1.5)
    np.testing.assert_allclose(knob.axis, (1, 0, 0), atol=1e-9)
    assert knob.limits == (-1.4, 1.4), "turns either way"
    assert next(link for link in safe.links if link.name == "link_2").mass == pytest.approx(0.2)
    # Annotated points, as far before them as AdaManip's hand holds.
    np.testing.assert_allclose(safe.part("handle").grasp[:3, 3], (0.0966, -0.08, 0.15), atol=1e-6)
    np.testing.assert_allclose(safe.part("knob").grasp[:3, 3], (0.0846, 0.02, 0.25), atol=1e-6)
    np.testing.assert_allclose(safe.part("knob").grasp[:3, 2], (-1, 0, 0), atol=1e-9)
    np.testing.assert_allclose(closing(safe, "knob"), (0, 0, 1), atol=1e-9)
    assert [motion.joint for motion in safe.part("handle").motions] == ["door"]
    assert [motion.joint for motion in safe.part("knob").motions] == ["door", "knob"]
    assert safe.part("handle").moved({"door": 0.6})[0, 3] > 0.15, "opens towards the robot"
    other = load_object(adamanip_safe(tmp_path / "sa2", limits=(-1.5, 0)), "safe").joint("door")
    assert other.limits == (0.0, 1.5), "one that opens to the negative side opens all the same"
    np.testing.assert_allclose(other.axis, (0, 0, -1), atol=1e-9)


def test_adamanip_s_bottle_is_held_from_above(tmp_path: Path) -> None:
    bottle = load_object(adamanip_bottle(tmp_path / "b1"), "bottle")
    lift, cap = bottle.joint("lift"), bottle.joint("cap")
    assert (lift.kind, lift.limits) == ("prismatic", (0.0, 0.05)), "upstream sets the limits at run time"
    assert (cap.kind, cap.limits) == ("revolute", (-2.35, 2.35))
    grasp = bottle.part("cap").grasp
    # The body is round and still: its front is 5 cm before its middle.
    np.testing.assert_allclose(grasp[:3, 2], (0, 0, -1), atol=1e-9)
    assert len(bottle.part("cap").rolls) > 2
    np.testing.assert_allclose(bottle.part("cap").moved({"lift": 0.04})[2, 3] - grasp[2, 3], 0.04, atol=1e-9)


def test_unidoormanip_s_door_is_read_with_collada(tmp_path: Path) -> None:
    pytest.importorskip("collada")
    door = load_object(unidoormanip_door(tmp_path / "99650089"), "door")
    np.testing.assert_allclose(door.size[::2], (0.60, 0.90), atol=1e-4)
    lever = door.part("lever")
    assert [motion.joint for motion in lever.motions] == ["leaf", "lever"]
    assert lever.moved({"leaf": 0.5})[0, 3] > lever.grasp[0, 3] + 0.1
    np.testing.assert_allclose(closing(door, "lever"), (0, 0, 1), atol=1e-9)


def test_partnet_mobility_needs_the_annotation_tool(tmp_path: Path) -> None:
    folder = partnet_safe(tmp_path / "101564")
    with pytest.raises(ConfigurationError, match=r"adamanip annotate \S*101564 --category safe"):
        load_object(folder, "safe")
    (folder / "adamanip.json").write_text(json.dumps(safe_annotation()))
    safe = load_object(folder, "safe")
    np.testing.assert_allclose(safe.size[::2], (0.4, 0.4), atol=0.01)
    assert safe.joint("knob").limits == (-1.4, 1.4)
    np.testing.assert_allclose(safe.part("handle").grasp[:3, 3], (0.06, -0.12, 0.2))
    assert safe.part("knob").rolls == (0.0,)
    red, green, blue = safe.links[0].shapes[0].material.color
    assert red > 2 * green > 0
    assert green > blue


def test_every_collision_shape_is_convex_and_unseen_and_near_what_is_seen(tmp_path: Path) -> None:
    for obj in (
        load_object(adamanip_safe(tmp_path / "sa1"), "safe"),
        load_object(annotated(tmp_path / "101564"), "safe"),
    ):
        shapes = [shape for link in obj.links for shape in link.shapes]
        assert {shape.visible for shape in shapes if shape.collides} == {False}
        assert {shape.visible for shape in shapes if not shape.collides} == {True}
        for shape in shapes:
            if shape.collides:
                normals, offsets = face_planes(shape)
                assert shape.vertices is not None
                assert (shape.vertices @ normals.T - offsets).max() < 1e-4
        for part in obj.parts:
            inward = part.grasp[:3, 3] + np.linspace(0, 0.06, 13)[:, None] * part.grasp[:3, 2]
            assert solid(obj, inward).any(), part.name


def test_an_angle_keeps_its_corner_free() -> None:
    pytest.importorskip("coacd")
    import trimesh

    outline = [(0, 0), (0.3, 0), (0.3, 0.03), (0.03, 0.03), (0.03, 0.3), (0, 0.3)]
    vertices = np.array([(x, y, z) for z in (0.0, 0.3) for x, y in outline])
    caps = [(0, k, k + 1) for k in range(1, 5)]
    sides = [(a, b, b + 6, a + 6) for a, b in zip(range(6), (1, 2, 3, 4, 5, 0), strict=True)]
    faces = [(a, c, b) for a, b, c in caps] + [(a + 6, b + 6, c + 6) for a, b, c in caps]
    faces += [(a, b, c) for a, b, c, _ in sides] + [(a, c, d) for a, _, c, d in sides]
    surface = Surface(vertices, np.array(faces), (1.0, 1.0, 1.0))
    for kept in (None, None, b"", b"PK cut"):  # the second time out of the cache, which then is damaged
        for path in convex_cache_folder().glob("*.npz") if kept is not None else ():
            path.write_bytes(kept)
        parts = convex_parts(surface)
        assert len(parts) > 1
        assert sum(trimesh.convex.convex_hull(part).volume for part, _ in parts) == pytest.approx(0.00513, rel=0.1)
    assert len(list(convex_cache_folder().glob("*.npz"))) == 1


def test_a_sheet_gets_a_thickness() -> None:
    vertices = np.array([(0, 0, 0), (1, 0, 1), (1, 1, 1), (0, 1, 0)], np.float64)
    ((hull, faces),) = convex_parts(Surface(vertices, np.array([(0, 1, 2), (0, 2, 3)]), (1.0, 1.0, 1.0)))
    assert len(faces) > 4
    assert np.ptp(hull, axis=0).max() < 1.01


def test_a_directory_is_listed_by_category(tmp_path: Path) -> None:
    adamanip_safe(tmp_path / "safe" / "sa2")
    adamanip_safe(tmp_path / "safe" / "sa1")
    adamanip_bottle(tmp_path / "bottle" / "b1")
    (tmp_path / "safe" / ".hidden").mkdir()
    assert AssetSource(tmp_path).ids("safe") == ("safe:sa1", "safe:sa2")
    assert AssetSource(tmp_path).ids("bottle") == ("bottle:b1",)
    assert AssetSource(tmp_path / "safe").ids("safe") == ("safe:sa1", "safe:sa2"), "one category's folder alone"
    assert AssetSource(tmp_path).load("safe:sa2").object_id == "safe:sa2"
    source = AssetSource(tmp_path)
    assert source.select("safe", "all") == source.select("safe", "seen") == ("safe:sa1", "safe:sa2")
    assert source.select("safe", "1:5") == source.select("safe", "safe:sa2") == ("safe:sa2",)
    assert is_asset_id("safe:sa1")
    assert not is_asset_id("safe_001")
    partnet_safe(tmp_path / "mixed" / "101564")
    assert AssetSource(tmp_path / "mixed").ids("safe") == ("safe:101564",), "told by what the folder says"
    with pytest.raises(ConfigurationError, match="No lamp found"):
        AssetSource(tmp_path / "mixed").ids("lamp")


@pytest.mark.parametrize(
    "selection", ["unseen", "novel", "7:9", "", "bottle:b1", "safe:nothing", "safe_001", "safe:../x"]
)
def test_a_wrong_selection_is_refused(tmp_path: Path, selection: str) -> None:
    adamanip_safe(tmp_path / "safe" / "sa1")
    with pytest.raises(ConfigurationError, match="allowed"):
        AssetSource(tmp_path).select("safe", selection)


def test_an_edited_mesh_in_a_folder_below_is_read_again(tmp_path: Path) -> None:
    folder = annotated(tmp_path / "101564")
    before = load_object(folder, "safe")
    assert load_object(folder, "safe") is before
    write_box(folder / "textured_objs" / "original-0.obj", (1.0, 0.05, 1.2), (0, -0.475, 0.15))
    assert load_object(folder, "safe").size[1] > before.size[1]


def test_one_bad_folder_is_left_out_and_told_and_its_id_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("sa1", "sa3"):
        adamanip_safe(tmp_path / "safe" / name)
    (adamanip_safe(tmp_path / "safe" / "sa2") / "door.obj").unlink()
    adamanip_safe(tmp_path / "safe" / "sa4", limits=(0, 0.17))
    source = AssetSource(tmp_path)
    assert [report.asset_id for report in source.check("safe") if not report.usable] == ["safe:sa2", "safe:sa4"]
    for _ in range(2):
        assert source.select("safe", "all") == source.select("safe", "seen") == ("safe:sa1", "safe:sa3")
    assert source.select("safe", "1:3") == ("safe:sa3",)
    warnings = [record.getMessage() for record in caplog.records if "2 of 4" in record.getMessage()]
    assert len(warnings) == 1, "told once, not with every selection"
    assert "safe:sa2: mobility.urdf: names a file that is missing. ('door.obj')" in warnings[0]
    assert "joint door goes 0.17 rad" in warnings[0]
    assert str(tmp_path / "safe") not in warnings[0], "reasons name files, not places"
    for name in ("safe:sa2", "safe:sa4"):
        assert source.select("safe", name) == (name,)
        with pytest.raises(ConfigurationError):
            source.load(name)
    with pytest.raises(ConfigurationError, match="can be used") as caught:
        source.select("safe", "3:4")
    assert "0.17" in str(caught.value)


@pytest.mark.parametrize(("upper", "usable"), [(0.17, False), (0.44, False), (0.48, False), (0.51, True)])
def test_a_goal_beyond_the_joint_s_limit_is_refused_at_load_and_at_save(
    tmp_path: Path, upper: float, usable: bool
) -> None:
    folder = adamanip_safe(tmp_path / "sa1", limits=(0, upper))
    draft = Draft(folder, "safe")
    if usable:
        assert infeasible(load_object(folder, "safe")) is None
        assert draft.problem() == ""
        return
    for use in (lambda: load_object(folder, "safe"), draft.save):
        with pytest.raises(ConfigurationError, match="can never be opened"):
            use()
    assert "its goal is beyond 0.449 rad" in draft.problem()
    draft.set_range("door", 0.0, 1.4)
    draft.save()
    assert load_object(folder, "safe").joint("door").limits == (0.0, 1.4)


def test_every_generated_object_and_every_range_that_urdfs_leave_open_reaches_its_goal() -> None:
    for category, roles in ROLES.items():
        obj = make_object(f"{category}_000")
        assert infeasible(obj) is None
        joints = {role.name: replace(obj.joint(role.name), limits=(0.0, role.upper)) for role in roles.joints}
        links = tuple(
            replace(link, joint=joints.get(link.joint.name, link.joint)) if link.joint is not None else link
            for link in obj.links
        )
        assert infeasible(replace(obj, links=links)) is None, category
