"""What a process keeps of the renderer from one environment to the next."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import sapien
from mani_skill.render.shaders import PREBUILT_SHADER_CONFIGS, set_shader_pack
from mani_skill.sensors.camera import CameraConfig

_UNLIT = {
    "gbuffer.frag": {
        "layout(set = 3, binding = 8) uniform sampler2D samplerBRDFLUT;": "",
        "vec2 envBRDF = texture(samplerBRDFLUT, vec2(roughness, dotNV)).xy;": "vec2 envBRDF = vec2(1, 0);",
    },
    "composite0.frag": {"layout(set = 2, binding = 8) uniform sampler2D samplerBRDFLUT;": ""},
}
"""File of SAPIEN's shader pack `minimal` -> what is written in it, and what instead."""
_kept: list[sapien.render.RenderSystem] = []
atexit.register(_kept.clear)


def keep_shaders(device: Any) -> None:
    """Holds a renderer on ``device`` (a `sapien.Device`) until the process ends.

    SAPIEN drops its compiled shaders with the last renderer, so that every environment after the first would compile
    them again: 5 s of two cores without a GPU.
    """
    if not _kept:
        _kept.append(sapien.render.RenderSystem(device))


def without_reflections(camera: CameraConfig) -> CameraConfig:
    """Returns a camera that takes the same pictures without the table of how surroundings are reflected.

    Of a scene without surroundings it draws the same to the bit, and that table takes 5 s of two cores without a GPU,
    in every process. Any shader but `minimal`, and one of another SAPIEN that is written otherwise, is left as it is.
    """
    if camera.shader_pack != "minimal" or (pack := _unlit_pack()) is None:
        return camera
    minimal = PREBUILT_SHADER_CONFIGS["minimal"]
    set_shader_pack(minimal)  # ManiSkill knows the formats of its pictures by the pack's name alone
    return replace(camera, shader_config=replace(minimal, shader_pack=str(pack)))


@functools.cache
def _unlit_pack() -> Path | None:
    """Writes the pack, for as long as the process lives."""
    packs = Path(sapien.__file__).parent / "vulkan_shader"
    changed: dict[str, str] = {}
    for file, lines in _UNLIT.items():
        path = packs / "minimal" / file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if any(text.count(line) != 1 for line in lines):
            return None
        changed[file] = functools.reduce(lambda whole, pair: whole.replace(*pair), lines.items(), text)
    folder = tempfile.mkdtemp(prefix="adamanip-shaders-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name in ("common", "minimal"):  # shaders of the second include files of the first
        shutil.copytree(packs / name, Path(folder) / name)
    pack = Path(folder) / "minimal"
    for file, text in changed.items():
        (pack / file).write_text(text, encoding="utf-8")
    return pack


def renderer_name() -> str:
    """Returns the names of the devices that SAPIEN can render with here, as their Vulkan drivers give them."""
    lines = [line.partition(":") for line in sapien.render.get_device_summary().splitlines()]
    return ", ".join(value.strip() for key, _, value in lines if key.strip() == "GPU") or "none"


__all__ = ["keep_shaders", "renderer_name", "without_reflections"]
