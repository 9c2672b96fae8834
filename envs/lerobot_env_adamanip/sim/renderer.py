"""SAPIEN's renderer: rendering scenes, and the parts that a process keeps between environments."""

from __future__ import annotations

import atexit
import contextlib
import functools
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.envs.utils.system.backend import parse_sim_and_render_backend
from mani_skill.render.shaders import PREBUILT_SHADER_CONFIGS, set_shader_pack
from mani_skill.sensors.camera import CameraConfig

from lerobot_adamanip.util.errors import AdaManipError, no_vulkan_device
from lerobot_env_adamanip.sim.render_device import can_render, has_vulkan_driver, resolve_render_backend

MANISKILL_NAMES = {"cuda": "gpu", "cpu": "cpu"}
"""This project's render backends -> ManiSkill's."""
BLIND = frozenset(("none", "state", "state_dict"))
"""ManiSkill's observation modes without a camera; the default is ``state``."""
_UNLIT = {
    "gbuffer.frag": {
        "layout(set = 3, binding = 8) uniform sampler2D samplerBRDFLUT;": "",
        "vec2 envBRDF = texture(samplerBRDFLUT, vec2(roughness, dotNV)).xy;": "vec2 envBRDF = vec2(1, 0);",
    },
    "composite0.frag": {"layout(set = 2, binding = 8) uniform sampler2D samplerBRDFLUT;": ""},
}
"""File of SAPIEN's shader pack `minimal` -> text in it -> its replacement."""
_kept: list[sapien.render.RenderSystem] = []
atexit.register(_kept.clear)


def device_for(render_backend: str, options: Mapping[str, Any]) -> str:
    """Returns the ``render_backend`` of ManiSkill's own scene; ``none`` if plain ManiSkill renders nothing."""
    observed, shown = options.get("obs_mode"), options.get("render_mode") is not None
    looks = shown or not (observed is None or set(observed.split("+")) <= BLIND)
    if not looks and (observed == "none" or not can_render()):
        return "none"
    return MANISKILL_NAMES[resolve_render_backend(render_backend)]


@contextlib.contextmanager
def translate_renderer_errors() -> Iterator[None]:
    """Turns SAPIEN's errors about a missing device into a `SimulatorError` with instructions."""
    try:
        yield
    except RuntimeError as error:
        words = ("vulkan", "vk", "render", "device", "extension")
        if isinstance(error, AdaManipError) or not any(word in str(error).lower() for word in words):
            raise
        raise no_vulkan_device(error) from error


def empty_scene(render_backend: str = "auto") -> ManiSkillScene:
    """Returns a scene that renders; raises `SimulatorError` if this machine cannot render."""
    if not has_vulkan_driver():  # otherwise SAPIEN prints its own errors first
        raise no_vulkan_device("no Vulkan driver is installed")
    backend = parse_sim_and_render_backend("physx_cpu", MANISKILL_NAMES[resolve_render_backend(render_backend)])
    try:
        keep_shaders(backend.render_device)
        raw = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem(backend.render_device)])
    except RuntimeError as error:
        raise no_vulkan_device(error) from error
    return ManiSkillScene([raw], device=backend.device, backend=backend)


def keep_shaders(device: Any) -> None:
    """Keeps a renderer on ``device`` (a `sapien.Device`) until the process ends.

    SAPIEN frees its compiled shaders with the last renderer; compiling them takes two cores 5 s without a GPU.
    """
    if not _kept:
        _kept.append(sapien.render.RenderSystem(device))


def without_reflections(camera: CameraConfig) -> CameraConfig:
    """Returns a camera with shaders that skip the reflection table, which takes two cores 5 s per process.

    In a scene without surroundings, images are bit-identical. Shaders other than `minimal`, and those of another SAPIEN
    version, are not changed.
    """
    if camera.shader_pack != "minimal" or (pack := _unlit_pack()) is None:
        return camera
    minimal = PREBUILT_SHADER_CONFIGS["minimal"]
    set_shader_pack(minimal)  # ManiSkill finds the image formats by the pack's name
    return replace(camera, shader_config=replace(minimal, shader_pack=str(pack)))


@functools.cache
def _unlit_pack() -> Path | None:
    """Writes the shader pack; it exists until the process ends."""
    packs = Path(sapien.__file__).parent / "vulkan_shader"
    changed: dict[str, str] = {}
    for file, lines in _UNLIT.items():
        path = packs / "minimal" / file
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        if any(text.count(line) != 1 for line in lines):
            return None
        changed[file] = functools.reduce(lambda whole, pair: whole.replace(*pair), lines.items(), text)
    folder = Path(tempfile.mkdtemp(prefix="adamanip-shaders-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for name in ("common", "minimal"):  # minimal includes files of common
        shutil.copytree(packs / name, folder / name)
    for file, text in changed.items():
        (folder / "minimal" / file).write_text(text, encoding="utf-8")
    return folder / "minimal"


def renderer_name() -> str:
    """Returns the names of SAPIEN's rendering devices, from their Vulkan drivers."""
    lines = [line.partition(":") for line in sapien.render.get_device_summary().splitlines()]
    return ", ".join(value.strip() for key, _, value in lines if key.strip() == "GPU") or "none"
