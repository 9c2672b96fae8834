"""What a process keeps of the renderer from one environment to the next."""

from __future__ import annotations

import atexit
from typing import Any

import sapien

_kept: list[sapien.render.RenderSystem] = []
atexit.register(_kept.clear)


def keep_shaders(device: Any) -> None:
    """Holds a renderer on ``device`` (a `sapien.Device`) until the process ends.

    SAPIEN drops its compiled shaders with the last renderer, so that every environment after the first would compile
    them again: 5 s of two cores without a GPU.
    """
    if not _kept:
        _kept.append(sapien.render.RenderSystem(device))


def renderer_name() -> str:
    """Returns the names of the devices that SAPIEN can render with here, as their Vulkan drivers give them."""
    lines = [line.partition(":") for line in sapien.render.get_device_summary().splitlines()]
    return ", ".join(value.strip() for key, _, value in lines if key.strip() == "GPU") or "none"


__all__ = ["keep_shaders", "renderer_name"]
