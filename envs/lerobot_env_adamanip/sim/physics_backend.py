"""What physics runs on, and whether ManiSkill makes its scene for rendering."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError, no_vulkan_device
from lerobot_env_adamanip.sim.render_device import MANISKILL_NAMES, can_render, resolve_render_backend

CPU_BACKENDS = ("auto", "cpu", "physx_cpu")
"""Names under which ManiSkill knows CPU physics."""
BLIND = frozenset(("none", "state", "state_dict"))
"""ManiSkill's observations that need no camera; no ``obs_mode`` is ``state``."""


def device_for(cloud_source: str, render_backend: str, options: Mapping[str, Any]) -> str:
    """Returns ManiSkill's name of the device that renders its scene: ``none`` if only rays are cast there.

    Where nothing renders, that is also so for plain ManiSkill whose observations show nothing.

    Args:
        cloud_source: see `lerobot_adamanip.episode.options.CLOUD_SOURCES`.
        render_backend: see `lerobot_adamanip.episode.options.RENDER_BACKENDS`.
        options: of ManiSkill's environment: whoever uses it plainly may look at it.
    """
    observed, shown = options.get("obs_mode"), options.get("render_mode") is not None
    looks = shown or cloud_source == "render" or not (observed is None or set(observed.split("+")) <= BLIND)
    if not looks and (observed == "none" or not can_render()):
        return "none"
    return MANISKILL_NAMES[resolve_render_backend(render_backend)]


@contextlib.contextmanager
def told_without_a_device() -> Iterator[None]:
    """Within it, an error of SAPIEN that finds no device to render with becomes a `SimulatorError` that says so."""
    try:
        yield
    except RuntimeError as error:
        words = ("vulkan", "vk", "render", "device", "extension")
        if isinstance(error, AdaManipError) or not any(word in str(error).lower() for word in words):
            raise
        raise no_vulkan_device(error) from error


def require_one_on_cpu(sim_backend: str, num_envs: int) -> None:
    """Raises `ConfigurationError` for physics on a GPU, or several environments in a process."""
    if sim_backend not in CPU_BACKENDS:
        raise ConfigurationError(
            "AdaManip tasks need CPU physics: their joint limits change while they run.",
            got=f"sim_backend={sim_backend!r}",
            allowed=", ".join(CPU_BACKENDS),
            hint="leave sim_backend out",
        )
    if num_envs != 1:
        raise ConfigurationError(
            "AdaManip tasks run one environment per process.",
            got=f"num_envs={num_envs}",
            allowed="1",
            hint="gymnasium's AsyncVectorEnv, or lerobot-eval --eval.batch_size=N",
        )
