"""Generated objects written down as somebody else's: a URDF with meshes, other names, another frame, no grasps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from asset_folders import joint, write_urdf

from lerobot_adamanip.objects import ArticulatedObject, Link
from lerobot_env_adamanip.sim.triangles import shapes_triangles


def export_object(obj: ArticulatedObject, folder: Path) -> Path:
    """Writes an object so that it faces -x, with joints ``joint_1``, ``joint_2`` and links ``part_...``."""
    elements = ['<link name="world"/>', joint("at", "fixed", "world", f"part_{obj.links[0].name}", rpy=f"0 0 {np.pi}")]
    number = 0
    for link in obj.links:
        elements.append(f'<link name="part_{link.name}">{_shapes(link, folder)}</link>')
        if (own := link.joint) is not None:
            number += 1
            limits = (max(0.0, own.limits[0]), own.limits[1])
            ends = (f"part_{link.parent}", f"part_{link.name}")
            elements.append(joint(f"joint_{number}", own.kind, *ends, own.origin, own.axis, limits))
    write_urdf(folder, *elements)
    return folder


def _shapes(link: Link, folder: Path) -> str:
    text = ""
    for number, shape in enumerate(link.shapes):
        path = folder / "meshes" / f"{link.name}_{number}.obj"
        path.parent.mkdir(parents=True, exist_ok=True)
        trimesh.Trimesh(**trimesh.triangles.to_kwargs(shapes_triangles([shape]))).export(path)
        mesh = f'<geometry><mesh filename="meshes/{path.name}"/></geometry>'
        color = " ".join(str(round(c ** (1 / 2.2), 5)) for c in shape.material.color)
        text += f'<visual>{mesh}<material name="m"><color rgba="{color} 1"/></material></visual>'
        text += f"<collision>{mesh}</collision>" if shape.collides else ""
    return text
