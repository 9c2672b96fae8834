"""One bad asset never costs the others: it is left out by name, and what is usable has parts of plausible size."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from asset_folders import adamanip_bottle, adamanip_safe, annotated, write_box

from lerobot_adamanip.assets import AssetSource, load_object
from lerobot_adamanip.assets.annotation.session import Draft
from lerobot_adamanip.assets.kinematics import link_poses
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.assets.urdf import read_urdf
from lerobot_adamanip.catalog import make_object, seen_objects
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_env_adamanip.sim.triangles import shapes_triangles

INCH = 0.0254
DECOMPOSED = "tu\u0308r"
"""An umlaut as archives of macOS hold it: a letter and a combining mark."""


def edited(folder: Path, *changes: tuple[str, str]) -> Path:
    path = folder / "mobility.urdf"
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return folder


def extents(obj: ArticulatedObject, link: str) -> np.ndarray:
    shapes = next(each for each in obj.links if each.name == link).shapes
    points = np.concatenate([each.vertices for each in shapes if each.visible and each.vertices is not None])
    return np.ptp(points, axis=0)


def moved_extent(obj: ArticulatedObject, joint: str) -> float:
    """Longest side of all that a joint moves [m]."""
    origins: dict[str | None, np.ndarray] = {None: np.zeros(3)}
    moved: set[str | None] = set()
    points = []
    for link in obj.links:
        origins[link.name] = origins[link.parent] + (np.zeros(3) if link.joint is None else link.joint.origin)
        if link.parent in moved or (link.joint is not None and link.joint.name == joint):
            moved.add(link.name)
            points.append(shapes_triangles(link.shapes).reshape(-1, 3) + origins[link.name])
    return float(np.ptp(np.concatenate(points), axis=0).max())


# Meshes that are missing ---------------------------------------------------------------------------------------------


def test_a_mesh_that_was_never_there_is_left_out_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = annotated(tmp_path / "101564")
    whole = load_object(folder, "safe")
    (folder / "textured_objs" / "original-0.obj").unlink()  # one of the body's five
    safe = load_object(folder, "safe")
    told = [each.getMessage() for each in caplog.records if "original-0.obj" in each.getMessage()]
    assert len(told) == 1, "once, though objects are loaded again and again"
    assert "left out" in told[0]
    assert str(folder) in told[0]
    assert "without 'textured_objs/original-0.obj'" in safe.description
    assert "without" not in whole.description
    assert len(safe.links[0].shapes) < len(whole.links[0].shapes)
    assert [each.problem for each in AssetSource(tmp_path).check("safe")] == [""]


@pytest.mark.parametrize(
    ("make", "mesh"),
    [
        *((adamanip_safe, f"{name}.obj") for name in ("body", "door", "handle", "knob")),
        (annotated, "textured_objs/original-6.obj"),  # the handle, among a door's meshes
    ],
)
def test_a_part_that_matters_must_have_a_mesh_left(tmp_path: Path, make: Callable[[Path], Path], mesh: str) -> None:
    folder = make(tmp_path / "sa1")
    (folder / mesh).unlink()
    with pytest.raises(ConfigurationError, match=mesh):
        load_object(folder, "safe")


def test_what_has_a_gap_as_a_solid_collides_as_it_is_seen(tmp_path: Path) -> None:
    solid = '<collision><origin xyz="0 0 0"/><geometry><mesh filename="{}"'
    folder = edited(adamanip_safe(tmp_path / "sa1"), (solid.format("knob.obj"), solid.format("gone.obj")))
    knob = next(link for link in load_object(folder, "safe").links if link.name == "link_2")
    assert any(shape.collides for shape in knob.shapes)


# Units and sizes -----------------------------------------------------------------------------------------------------


def safe_with_collada_knob(folder: Path, size: float, unit: str) -> Path:
    """``size``: of the file's numbers over those of a knob in metres."""
    adamanip_safe(folder)
    write_box(folder / "knob.dae", (0.03 * size, 0.03 * size, 0.06 * size), (0, 0, 0.03 * size))
    path = folder / "knob.dae"
    text = path.read_text()
    assert "<asset>" in text
    assert "<unit" not in text
    path.write_text(text.replace("<asset>", f"<asset>{unit}"))
    return edited(folder, ("knob.obj", "knob.dae"))


@pytest.mark.parametrize(
    ("size", "unit"),
    [(1.0, ""), (1 / INCH, f'<unit name="inch" meter="{INCH}"/>'), (100.0, '<unit meter="0.01"/>')],
)
def test_a_collada_file_s_unit_is_honoured(tmp_path: Path, size: float, unit: str) -> None:
    pytest.importorskip("collada")
    safe = load_object(safe_with_collada_knob(tmp_path / "sa1", size, unit), "safe")
    assert sorted(extents(safe, "link_2")) == pytest.approx([0.03, 0.03, 0.06], rel=1e-3)


@pytest.mark.parametrize(
    ("size", "unit", "match"),
    [
        (1.0, f'<unit meter="{INCH}"/>', "knob is of a size no safe has"),
        (1 / INCH, "", "knob is of a size no safe has"),
        (1.0, '<unit meter="-1"/>', "no length"),
        (1.0, '<unit meter="nan"/>', "finite number"),
    ],
)
def test_a_unit_that_cannot_be_is_refused(tmp_path: Path, size: float, unit: str, match: str) -> None:
    pytest.importorskip("collada")
    with pytest.raises(ConfigurationError, match=match):
        load_object(safe_with_collada_knob(tmp_path / "sa1", size, unit), "safe")


@pytest.mark.parametrize("factor", [1 / 1000, INCH, 1 / INCH, 1000])
@pytest.mark.parametrize("tag", ["visual", "collision"])
def test_no_part_in_another_unit_is_called_usable(tmp_path: Path, factor: float, tag: str) -> None:
    element = f'<{tag}><origin xyz="0 0 0"/><geometry><mesh filename="knob.obj"'
    scaled = f'{element} scale="{factor} {factor} {factor}"'
    edited(adamanip_safe(tmp_path / "sa1"), (element, scaled))
    (report,) = AssetSource(tmp_path).check("safe")
    assert "of a size" in report.problem


@pytest.mark.parametrize("category", sorted(ROLES))
def test_the_usual_sizes_are_those_of_generated_objects(category: str) -> None:
    roles = ROLES[category]
    for obj in map(make_object, seen_objects(category)[:3]):
        assert roles.typical_size / 3 < max(obj.size) < 3 * roles.typical_size, obj.object_id
        for role in roles.joints:
            smallest, largest = role.extents
            assert 0.95 * smallest < moved_extent(obj, role.name) < 1.05 * largest, (obj.object_id, role.name)


# Names ---------------------------------------------------------------------------------------------------------------

BAD_NAMES = ["sa2 (1)", DECOMPOSED, "a:b", "a,b", "trailing ", " leading", "x" * 150, "new\nline", "b\udcffytes"]


@pytest.mark.parametrize("name", BAD_NAMES)
def test_a_name_that_cannot_be_an_id_costs_its_folder_alone(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    adamanip_safe(tmp_path / "safe" / "sa1")
    (tmp_path / "safe" / "sa1").rename(tmp_path / "kept")
    (tmp_path / "safe" / name).symlink_to(tmp_path / "kept")
    (tmp_path / "safe" / "good one").symlink_to(tmp_path / "kept")
    source = AssetSource(tmp_path)
    assert source.ids("safe") == source.select("safe", "all") == source.select("safe", "0:9") == ("safe:good one",)
    good, bad = sorted(source.check("safe"), key=lambda each: not each.usable)
    assert good.asset_id == "safe:good one"
    assert "rename the folder" in bad.problem
    (told,) = [each.getMessage() for each in caplog.records if "left out" in each.getMessage()]
    assert bad.asset_id in told
    told.encode()  # what cannot be printed is escaped
    if name == DECOMPOSED:
        assert "u0308" in bad.problem, "seen although it is drawn into the letter before it"
    with pytest.raises(ConfigurationError):
        source.load(f"safe:{name}")


def test_links_have_ids_of_their_own(tmp_path: Path) -> None:
    adamanip_safe(tmp_path / "store" / "v2 (final)")
    (tmp_path / "safe").mkdir()
    for name in ("one", "two"):
        (tmp_path / "safe" / name).symlink_to(tmp_path / "store" / "v2 (final)", target_is_directory=True)
    source = AssetSource(tmp_path)
    assert source.select("safe", "all") == ("safe:one", "safe:two")
    assert [source.load(name, solid=False).object_id for name in source.ids("safe")] == ["safe:one", "safe:two"]


def test_an_id_stands_for_one_folder(tmp_path: Path) -> None:
    ours, theirs = ROLES["coffee_maker"].folders[:2]
    for place in (ours, theirs):
        adamanip_bottle(tmp_path / place / "c1")
    source = AssetSource(tmp_path)
    assert source.ids("coffee_maker") == ("coffee_maker:c1",)
    assert source.folder("coffee_maker:c1") == tmp_path / ours / "c1"
    assert sum("same name" in each.problem for each in source.check("coffee_maker")) == 1


def test_a_folder_that_is_named_by_dots_has_its_own_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = adamanip_safe(tmp_path / "sa1")
    (folder / "inner").mkdir()
    monkeypatch.chdir(folder)
    for written in (".", "inner/..", "../sa1"):
        assert load_object(Path(written), "safe").object_id == "safe:sa1"


# Colours, joints that follow others, paths ---------------------------------------------------------------------------


@pytest.mark.parametrize(("rgba", "read"), [("1 0 0 1", True), ("1 0 0", True), ("red", False), ("1 0", False)])
def test_a_colour_costs_no_object(tmp_path: Path, rgba: str, read: bool, caplog: pytest.LogCaptureFixture) -> None:
    knob = '<link name="link_2"><visual>'
    colored = f'{knob}<material name="m"><color rgba="{rgba}"/></material>'
    safe = load_object(edited(adamanip_safe(tmp_path / "sa1"), (knob, colored)), "safe")
    shapes = next(link for link in safe.links if link.name == "link_2").shapes
    assert (shapes[0].material.color == (1.0, 0.0, 0.0)) is read
    assert any("colour" in each.getMessage() for each in caplog.records) is not read


def following(folder: Path, joint: str, leader: str, how: str = "") -> Path:
    start = f'<joint name="{joint}" type="revolute">'
    return edited(adamanip_safe(folder), (start, f'{start}<mimic joint="{leader}" {how}/>'))


def test_a_joint_that_follows_another_cannot_be_what_opens_or_releases(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="does not move by itself"):
        load_object(following(tmp_path / "sa1", "joint_2", "joint_1"), "safe")
    with pytest.raises(ConfigurationError, match="finite number"):
        load_object(following(tmp_path / "sa2", "joint_3", "joint_1", "multiplier='nan'"), "safe")
    proposed = Draft(following(tmp_path / "sa3", "joint_2", "joint_3"), "safe")
    chosen = {each.joint for each in proposed.annotation.joints.values()}
    assert chosen == {"joint_1", "joint_2"}, "by name, as AdaManip's code does, and its page says why it cannot be"
    assert "mimic" in proposed.problem()


def test_a_joint_that_follows_one_that_plays_a_role_is_told_of_and_stands_where_it_should(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = following(tmp_path / "sa1", "joint_3", "joint_2", "multiplier='-0.5' offset='0.2'")
    load_object(folder, "safe")
    (told,) = [each.getMessage() for each in caplog.records if "mimic" in each.getMessage()]
    assert "'joint_3' follows 'joint_2'" in told
    urdf = read_urdf(folder / "mobility.urdf")
    turned = link_poses(urdf, {"joint_2": 1.0})["link_3"]
    alone = link_poses(urdf, {"joint_3": -0.3})["link_3"]
    np.testing.assert_allclose(turned, alone)


@pytest.mark.parametrize("leader", ["joint_3", "nowhere", ""])
def test_a_joint_that_follows_itself_or_nothing_is_no_endless_loop(tmp_path: Path, leader: str) -> None:
    assert load_object(following(tmp_path / "sa1", "joint_3", leader), "safe").size[2] > 0


@pytest.mark.parametrize("written", ["KNOB.OBJ", ".\\Knob.obj", "package://Sa 1/Knob.obj", "textures/../knob.obj"])
def test_a_file_inside_the_folder_is_read_however_it_is_named(tmp_path: Path, written: str) -> None:
    folder = edited(adamanip_safe(tmp_path / "sa 1"), ("knob.obj", written))
    (tmp_path / "link").symlink_to(folder)
    for way in (folder, tmp_path / "link"):
        assert extents(load_object(way, "safe", solid=False), "link_2").max() == pytest.approx(0.06)


@pytest.mark.parametrize("written", ["/home/me/sa1/meshes/knob.obj", "C:\\safes\\knob.obj", "old/knob.obj"])
def test_a_file_that_lies_elsewhere_in_the_folder_is_advised(tmp_path: Path, written: str) -> None:
    folder = edited(adamanip_safe(tmp_path / "sa1"), ("knob.obj", written))
    (folder / "parts").mkdir()
    (folder / "knob.obj").rename(folder / "parts" / "Knob.obj")
    with pytest.raises(ConfigurationError, match=r"name it 'parts/Knob.obj'"):
        load_object(folder, "safe")


def test_two_files_that_differ_in_case_are_not_guessed_at(tmp_path: Path) -> None:
    folder = edited(adamanip_safe(tmp_path / "sa1"), ("knob.obj", "KNOB.OBJ"))
    os.link(folder / "knob.obj", folder / "Knob.obj")
    with pytest.raises(ConfigurationError, match="missing"):
        load_object(folder, "safe")


def test_no_case_leads_out_of_the_folder(tmp_path: Path) -> None:
    folder = edited(adamanip_safe(tmp_path / "sa1"), ("knob.obj", "OUT/knob.obj"))
    (tmp_path / "elsewhere").mkdir()
    (folder / "knob.obj").rename(tmp_path / "elsewhere" / "knob.obj")
    (folder / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigurationError, match=r"missing|link out"):
        load_object(folder, "safe")
