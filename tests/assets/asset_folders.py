"""Small external assets, written in the layouts of the collections they stand for. No asset of theirs is in here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

UPRIGHT = "1.5707963267948966 0 -1.5707963267948966"
"""AdaManip's joint_0: link frames y up, z out of the front, which is -x of the root."""
SAFE_HANDLE, SAFE_KNOB = (-0.10, 0.0, 0.06), (0.0, 0.0, 0.05)
"""Annotated points in the frames of their links [m]."""


def joint(name: str, kind: str, parent: str, child: str, *rest: Any, rpy: str = "0 0 0") -> str:
    """``rest``: origin, axis, limits."""
    xyz, axis, limits = (*rest, None, None, None)[:3]
    inner = f'<origin xyz="{" ".join(map(str, xyz or (0, 0, 0)))}" rpy="{rpy}"/>'
    inner += f'<parent link="{parent}"/><child link="{child}"/>'
    if axis is not None:
        inner += f'<axis xyz="{" ".join(map(str, axis))}"/>'
    if limits is not None:
        inner += f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/>'
    return f'<joint name="{name}" type="{kind}">{inner}</joint>'


def link(name: str, *meshes: str, mass: float | None = None) -> str:
    body = "".join(
        f'<{tag}><origin xyz="0 0 0"/><geometry><mesh filename="{mesh}"/></geometry></{tag}>'
        for mesh in meshes
        for tag in ("visual", "collision")
    )
    if mass is not None:
        body += f'<inertial><mass value="{mass}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    return f'<link name="{name}">{body}</link>'


def write_urdf(folder: Path, *elements: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "mobility.urdf"
    path.write_text(f'<?xml version="1.0"?><robot name="x">{"".join(elements)}</robot>', encoding="utf-8")
    return path


def write_box(path: Path, extents: Any, center: Any = (0, 0, 0)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh = trimesh.creation.box(extents=extents)
    mesh.apply_translation(center)
    mesh.export(path)


def adamanip_safe(folder: Path, limits: tuple[float, float] = (0, 1.5)) -> Path:
    """A safe, 30 x 40 x 25 cm, hinged on the object's +y side; three joints."""
    write_box(folder / "body.obj", (0.30, 0.40, 0.25), (0, 0, -0.125))
    write_box(folder / "door.obj", (0.28, 0.38, 0.03), (-0.14, 0, 0.015))
    write_box(folder / "handle.obj", (0.02, 0.10, 0.03), (0, 0, 0.055))
    write_box(folder / "knob.obj", (0.03, 0.03, 0.06), (0, 0, 0.03))
    write_urdf(
        folder,
        link("base"),
        link("link_0", "body.obj"),
        link("link_1", "door.obj"),
        link("link_2", "knob.obj", mass=0.2),
        link("link_3", "handle.obj"),
        joint("joint_0", "fixed", "base", "link_0", rpy=UPRIGHT),
        joint("joint_1", "revolute", "link_0", "link_1", (0.14, 0, 0), (0, 1, 0), limits),
        joint("joint_2", "revolute", "link_1", "link_2", (-0.12, 0.05, 0.03), (0, 0, 1), (0, 1.4)),
        joint("joint_3", "revolute", "link_1", "link_3", (-0.22, -0.05, 0.03), (0, 0, 1), (0, 0.5)),
    )
    torch.save(torch.tensor([0.0, 0.0, 0.06]), folder / "handle_pos.npy")
    torch.save(torch.tensor(SAFE_KNOB), folder / "knob_pos.npy")
    (folder / "bounding_box.json").write_text(json.dumps({"min": [0, 0, -0.2], "max": [0, 0, 0.2]}))
    return folder


def adamanip_bottle(folder: Path) -> Path:
    """A bottle, 10 wide and 20 high, whose cap lifts and turns: primitives, and a point in numpy's format."""
    cylinder = "<origin rpy='1.5707963267948966 0 0'/><geometry><cylinder radius='{r}' length='{l}'/></geometry>"
    shapes = f"<visual>{cylinder}</visual>"
    write_urdf(
        folder,
        "<link name='base'/>",
        f"<link name='body'>{shapes.format(r=0.05, l=0.2)}</link>",
        "<link name='slide'/>",
        f"<link name='cap'>{shapes.format(r=0.02, l=0.03)}</link>",
        joint("joint_0", "fixed", "base", "body", rpy=UPRIGHT),
        joint("joint_1", "prismatic", "body", "slide", (0, 0.115, 0), (0, 1, 0), (0, 0)),
        joint("joint_2", "continuous", "slide", "cap", (0, 0, 0), (0, 1, 0)),
    )
    np.save(folder / "goal_pos.npy", np.zeros(3))
    return folder


def unidoormanip_door(folder: Path) -> Path:
    """A door with a lever: Collada meshes, and the point in handle_bounding.json."""
    write_box(folder / "texture_dae" / "frame.dae", (0.60, 0.9, 0.05), (0, 0, -0.03))
    write_box(folder / "texture_dae" / "leaf.dae", (0.56, 0.86, 0.04), (0.28, 0, 0))
    write_box(folder / "texture_dae" / "lever.dae", (0.12, 0.02, 0.02), (-0.05, 0, 0.06))
    write_urdf(
        folder,
        link("base"),
        link("link_0", "texture_dae/frame.dae"),
        link("link_1", "texture_dae/leaf.dae"),
        link("link_2", "package://door/texture_dae/lever.dae"),
        joint("joint_0", "fixed", "base", "link_0", rpy=UPRIGHT),
        joint("joint_1", "revolute", "link_0", "link_1", (-0.28, 0, 0.01), (0, -1, 0), (0, 1.508)),
        joint("joint_2", "revolute", "link_1", "link_2", (0.48, 0, 0.02), (0, 0, 1), (0, 1.05)),
    )
    found = {"handle_min": [0, 0, 0], "handle_max": [1, 1, 1], "goal_pos": [-0.05, 0.0, 0.06]}
    (folder / "handle_bounding.json").write_text(json.dumps(found))
    return folder


def full_size_door(folder: Path, width: float = 0.9, height: float = 2.0, lever_height: float = 1.0) -> Path:
    """A door as houses have it, in UniDoorManip's layout: a leaf of ``width`` x ``height``, a lever on a neck [m]."""
    middle, spindle = height / 2, width - 0.06
    up = lever_height - middle
    for x in (-width / 2 - 0.05, width / 2 + 0.05):
        write_box(folder / "texture_dae" / f"post{int(x > 0)}.obj", (0.08, height + 0.1, 0.12), (x, 0.05, -0.06))
    write_box(folder / "texture_dae" / "head.obj", (width + 0.02, 0.08, 0.12), (0, middle + 0.06, -0.06))
    write_box(folder / "texture_dae" / "leaf.obj", (width, height, 0.04), (width / 2, 0, -0.02))
    write_box(folder / "texture_dae" / "lever.obj", (0.13, 0.02, 0.02), (-0.055, 0, 0.055))
    write_box(folder / "texture_dae" / "neck.obj", (0.02, 0.02, 0.055), (0, 0, 0.0275))
    frame = ("texture_dae/post0.obj", "texture_dae/post1.obj", "texture_dae/head.obj")
    write_urdf(
        folder,
        link("base"),
        link("link_0", *frame),
        link("link_1", "texture_dae/leaf.obj"),
        link("link_2", "texture_dae/lever.obj", "texture_dae/neck.obj"),
        joint("joint_0", "fixed", "base", "link_0", rpy=UPRIGHT),
        joint("joint_1", "revolute", "link_0", "link_1", (-width / 2, 0, 0), (0, -1, 0), (0, 1.508)),
        joint("joint_2", "revolute", "link_1", "link_2", (spindle, up, 0), (0, 0, 1), (0, 1.05)),
    )
    (folder / "handle_bounding.json").write_text(json.dumps({"goal_pos": [-0.07, 0.0, 0.055]}))
    return folder


def partnet_safe(folder: Path) -> Path:
    """PartNet-Mobility: about one unit large, names of its own, several meshes a link with materials, no grasps."""
    meshes = folder / "textured_objs"
    for number, (extents, center) in enumerate(
        [
            ((1.0, 0.05, 0.9), (0, -0.475, 0)),
            ((1.0, 0.05, 0.9), (0, 0.475, 0)),
            ((0.05, 0.9, 0.9), (-0.475, 0, 0)),
            ((0.05, 0.9, 0.9), (0.475, 0, 0)),
            ((1.0, 1.0, 0.05), (0, 0, -0.45)),
            ((0.9, 0.9, 0.06), (-0.45, 0, 0)),
            ((0.08, 0.3, 0.15), (-0.75, 0, 0.1)),
            ((0.12, 0.12, 0.15), (0, 0, 0.075)),
        ]
    ):
        path = meshes / f"original-{number}.obj"
        write_box(path, extents, center)
        text = "\n".join(row for row in path.read_text().splitlines() if not row.startswith(("mtllib", "usemtl")))
        path.write_text(f"mtllib m{number}.mtl\nusemtl paint\n{text}\n")
        path.with_name(f"m{number}.mtl").write_text("newmtl paint\nKd 0.8 0.2 0.1\nKa 0 0 0\nKs 0 0 0\n")
    body = [f"textured_objs/original-{n}.obj" for n in range(5)]
    write_urdf(
        folder,
        link("base"),
        link("link_1", *body),
        link("link_0", "textured_objs/original-5.obj", "textured_objs/original-6.obj"),
        link("link_2", "textured_objs/original-7.obj"),
        joint("joint_1", "fixed", "base", "link_1", rpy=UPRIGHT),
        joint("joint_0", "revolute", "link_1", "link_0", (0.45, 0, 0.42), (0, 1, 0), (0, 1.57)),
        joint("joint_2", "continuous", "link_0", "link_2", (-0.45, 0, 0.03), (0, 0, 1)),
    )
    (folder / "semantics.txt").write_text("link_0 hinge door\nlink_1 heavy safe_body\nlink_2 hinge knob\n")
    (folder / "meta.json").write_text(json.dumps({"model_cat": "Safe", "anno_id": "1"}))
    return folder


def annotated(folder: Path, **changes: Any) -> Path:
    """The same safe with an annotation, some of whose values are changed."""
    partnet_safe(folder)
    (folder / "adamanip.json").write_text(json.dumps(safe_annotation(**changes)))
    return folder


def safe_annotation(**changes: Any) -> dict[str, Any]:
    """The annotation tool's file for `partnet_safe`, at 0.4 m a unit."""
    turned = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]  # approach -x, fingers close along y

    def grasp(x: float, y: float, z: float) -> list[list[float]]:
        return [[*row, at] for row, at in zip(turned, (x, y, z), strict=True)] + [[0, 0, 0, 1]]

    content: dict[str, Any] = {
        "format": "adamanip-annotation",
        "version": 1,
        "category": "safe",
        "scale": 0.4,
        "object_in_urdf": [[-1, 0, 0, -0.18], [0, -1, 0, 0], [0, 0, 1, -0.2], [0, 0, 0, 1]],
        "joints": {
            "door": {"joint": "joint_0", "rest": 0.0, "open": 1.5},
            "knob": {"joint": "joint_2", "rest": 0.0, "open": 1.4},
        },
        "parts": {
            "handle": {"link": "link_0", "grasp": grasp(0.06, -0.12, 0.2), "rolls": [0.0, 3.14159]},
            "knob": {"link": "link_2", "grasp": grasp(0.06, 0.0, 0.2), "rolls": [0.0]},
        },
    }
    return content | changes
