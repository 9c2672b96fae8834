"""What others wrote is not trusted: broken, hostile and incomplete folders end in one message that says what to do."""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from asset_folders import (
    adamanip_bottle,
    adamanip_safe,
    annotated,
    joint,
    link,
    partnet_safe,
    safe_annotation,
    write_urdf,
)

from lerobot_adamanip.assets import AssetSource, load_object
from lerobot_adamanip.assets.annotation.session import Draft
from lerobot_adamanip.assets.kinematics import groups
from lerobot_adamanip.assets.urdf import read_urdf
from lerobot_adamanip.util.errors import ConfigurationError

LAUGHS = """<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]><robot>&b;</robot>"""
EXTERNAL = """<?xml version="1.0"?><!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>"""
CIRCLE = joint("x", "fixed", "b", "c") + joint("y", "fixed", "c", "b")


def refused(folder: Path, match: str, category: str = "safe") -> None:
    with pytest.raises(ConfigurationError, match=match) as caught:
        load_object(folder, category)
    assert all(word in str(caught.value) for word in ("got:", "allowed:", "try:"))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (LAUGHS, "entities"),
        (EXTERNAL, "entities"),
        ("<robot", "not XML"),
        ("", "not XML"),
        ("<sdf/>", "not a URDF"),
        ("<robot/>", "link names"),
        ("<robot><link name='a'/><link name='a'/></robot>", "not unique"),
        ("<robot><link name='a'/><link name='b'/></robot>", "one tree"),
        ("<robot>" + "<a>" * 100_000 + "</a>" * 100_000 + "</robot>", "link names"),
        (f"<robot><link name='a'/><link name='b'/><link name='c'/>{CIRCLE}</robot>", "one tree"),
        ("<robot><link/></robot>", "no name"),
        ("<robot><link name='a'/><joint name='j' type='floating'/></robot>", "type that is not known"),
        ("<robot><link name='a'/><joint name='j' type='fixed'/></robot>", "link that does not exist"),
        ("<robot><link name='a'><visual><geometry><box size='1 nan 1'/></geometry></visual></link></robot>", "finite"),
        ("<robot><link name='a'><visual><geometry><box size='1 1'/></geometry></visual></link></robot>", "3 finite"),
        ("<robot><link name='a'><visual><geometry><heap/></geometry></visual></link></robot>", "no shape"),
        ("<robot><link name='a'><visual><geometry><box size='1 -1 1'/></geometry></visual></link></robot>", "extent"),
        ("<robot><link name='a'><inertial><mass value='1e999'/></inertial></link></robot>", "finite"),
    ],
)
def test_a_broken_urdf(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "mobility.urdf").write_text(text)
    refused(tmp_path, match)


def test_a_long_chain_of_links_is_no_deep_recursion(tmp_path: Path) -> None:
    names = [f"l{number}" for number in range(990)]
    chain = [joint(f"f{number}", "fixed", *names[number : number + 2]) for number in range(len(names) - 1)]
    urdf = read_urdf(write_urdf(tmp_path, *map(link, reversed(names)), *chain))
    assert set(groups(urdf, {}).values()) == {"l0"}


def test_an_object_without_meshes_is_one_error(tmp_path: Path) -> None:
    folder = annotated(tmp_path / "x1")
    for mesh in folder.rglob("*.obj"):
        mesh.unlink()
    with pytest.raises(ConfigurationError, match="nothing to be seen"):
        Draft(folder, "safe").object()


def test_no_urdf_and_no_directory(tmp_path: Path) -> None:
    refused(tmp_path, "no such file")
    with pytest.raises(ConfigurationError, match="does not exist"):
        AssetSource(tmp_path / "nowhere").ids("safe")
    with pytest.raises(ConfigurationError, match="Unknown category"):
        AssetSource(tmp_path).ids("teapot")


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("../outside.obj", "outside its folder"),
        ("a/../../outside.obj", "outside its folder"),
        ("..\\\\outside.obj", "outside its folder"),
        ("/etc/passwd", "outside its folder"),
        ("file:///etc/passwd", "outside its folder"),
        ("https://example.com/x.obj", "outside its folder"),
        ("package:///etc/passwd", "outside its folder|missing"),
        ("package://x/../../outside.obj", "outside its folder"),
        ("missing.obj", "missing"),
        ("", "missing"),
        ("linked.obj", "link out of its folder"),
        ("mobility.urdf", "not a mesh"),
        ("noise.obj", "its knob moves no shape"),
        ("noise.glb", "cannot be read"),
    ],
)
def test_a_mesh_that_is_not_to_be_had(tmp_path: Path, name: str, match: str) -> None:
    folder = adamanip_safe(tmp_path / "sa1")
    (tmp_path / "outside.obj").write_text("v 0 0 0\n")
    (folder / "linked.obj").symlink_to(tmp_path / "outside.obj")
    for noise in ("noise.obj", "noise.glb"):
        (folder / noise).write_bytes(np.random.default_rng(0).bytes(500))
    path = folder / "mobility.urdf"
    path.write_text(path.read_text().replace("knob.obj", name))
    refused(folder, match)


def test_a_material_cannot_lead_out_of_the_folder(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = adamanip_safe(tmp_path / "sa1")
    (tmp_path / "secret.mtl").write_text("newmtl paint\nKd 1 0 0\n")
    path = folder / "knob.obj"
    path.write_text("mtllib ../secret.mtl\nusemtl paint\n" + path.read_text())
    knob = next(link for link in load_object(folder, "safe").links if link.name == "link_2")
    assert knob.shapes[0].material.color != (1.0, 0.0, 0.0)


def test_a_collada_file_with_entities(tmp_path: Path) -> None:
    folder = adamanip_safe(tmp_path / "sa1")
    (folder / "knob.dae").write_text(LAUGHS)
    path = folder / "mobility.urdf"
    path.write_text(path.read_text().replace("knob.obj", "knob.dae"))
    refused(folder, "entities")


class Exploit:
    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.system, ("touch exploited",)


@pytest.mark.parametrize(
    "thing", [Exploit(), {"a": 1}, [1.0, 2.0, 3.0], torch.zeros(4), torch.tensor([0.0, float("nan"), 0.0])]
)
def test_a_pickle_is_no_point(tmp_path: Path, thing: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = adamanip_safe(tmp_path / "sa1")
    torch.save(thing, folder / "knob_pos.npy")
    refused(folder, "point")
    assert not (tmp_path / "exploited").exists()


def saved_objects() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.array([Exploit(), 1, 2], dtype=object), allow_pickle=True)
    return buffer.getvalue()


def archived_pickle() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("goal_pos/data.pkl", b"cos\nsystem\n(S'touch exploited'\ntR.")
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [b"", b"hello", b"\x93NUMPY\x01\x00", b"PK\x03\x04", b"\0" * 2_000_000, saved_objects(), archived_pickle()],
    ids=["empty", "text", "cut", "zip", "large", "objects", "archive"],
)
def test_noise_is_no_point(tmp_path: Path, content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = adamanip_bottle(tmp_path / "b1")
    (folder / "goal_pos.npy").write_bytes(content)
    refused(folder, "point", "bottle")
    assert not (tmp_path / "exploited").exists()


def test_joints_of_the_wrong_kind(tmp_path: Path) -> None:
    refused(adamanip_bottle(tmp_path / "b1"), "cannot be the door|does not say", "safe")
    folder = adamanip_safe(tmp_path / "sa1")
    path = folder / "mobility.urdf"
    path.write_text(path.read_text().replace('name="joint_1" type="revolute"', 'name="joint_1" type="prismatic"'))
    refused(folder, "cannot be the door")
    path.write_text(path.read_text().replace("prismatic", "fixed").replace("revolute", "fixed"))
    refused(folder, "two joints that move")


NAN, NO_FLOAT = float("nan"), 10**400
SLANTED = [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
DOOR, KNOB = safe_annotation()["joints"]["door"], safe_annotation()["joints"]["knob"]
HANDLE, KNOB_PART = safe_annotation()["parts"]["handle"], safe_annotation()["parts"]["knob"]
FAR = np.block([[np.eye(3), np.full((3, 1), 2.0)], [np.zeros(3), 1]]).tolist()


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"format": "other"}, "not an annotation"),
        ({"version": 2}, "not an annotation"),
        ({"category": "lamp"}, "another category"),
        ({"scale": NAN}, "cannot be"),
        ({"scale": 0}, "cannot be"),
        ({"scale": NO_FLOAT}, "cannot be"),
        ({"scale": 30.0}, "of a size"),
        ({"object_in_urdf": SLANTED}, "cannot be"),
        ({"object_in_urdf": [[1, 2], [3, 4]]}, "cannot be"),
        ({"object_in_urdf": [[1, 0, 0, NO_FLOAT], *SLANTED[1:]]}, "cannot be"),
        ({"joints": {"door": DOOR}}, "without knob"),
        ({"joints": {"door": DOOR, "knob": {**KNOB, "open": 0.0}}}, "cannot be"),
        ({"joints": {"door": DOOR, "knob": {**KNOB, "rest": NAN}}}, "cannot be"),
        ({"joints": {"door": DOOR, "knob": {**KNOB, "rest": NO_FLOAT}}}, "cannot be"),
        ({"joints": {"door": {**DOOR, "open": 1e300}, "knob": KNOB}}, "cannot be"),
        ({"joints": {"door": DOOR, "knob": DOOR}}, "not two of its own"),
        ({"joints": {"door": DOOR, "knob": {**KNOB, "joint": "joint_9"}}}, "not two of its own"),
        ({"joints": []}, "incomplete"),
        ({"parts": {}}, "without handle, knob"),
        ({"parts": {"handle": HANDLE, "knob": {**KNOB_PART, "link": "link_7"}}}, "does not exist"),
        ({"parts": {"handle": {**HANDLE, "link": "link_1"}, "knob": KNOB_PART}}, "moves with nothing"),
        ({"parts": {"handle": {**HANDLE, "grasp": FAR}, "knob": KNOB_PART}}, "outside of the object"),
        ({"parts": {"handle": {**HANDLE, "rolls": []}, "knob": KNOB_PART}}, "cannot be"),
        ({"parts": {"handle": {**HANDLE, "rolls": [NO_FLOAT]}, "knob": KNOB_PART}}, "cannot be"),
        ({"parts": {"handle": {**HANDLE, "grasp": "here"}, "knob": KNOB_PART}}, "cannot be"),
    ],
)
def test_a_wrong_annotation(tmp_path: Path, changes: dict[str, object], match: str) -> None:
    refused(annotated(tmp_path / "101564", **changes), match)


@pytest.mark.parametrize("text", ["", "[]", "{", "[" * 100_000, "null"])
def test_an_annotation_that_is_none(tmp_path: Path, text: str) -> None:
    folder = partnet_safe(tmp_path / "101564")
    (folder / "adamanip.json").write_text(text)
    refused(folder, "adamanip.json")
