"""What physics runs on, and whether ManiSkill makes its scene for rendering."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lerobot_adamanip.errors import ConfigurationError
from lerobot_env_adamanip.sim.render_device import MANISKILL_NAMES, resolve_render_backend

CPU_BACKENDS = ("auto", "cpu", "physx_cpu")
"""Names under which ManiSkill knows CPU physics."""


def device_for(cloud_source: str, render_backend: str, options: Mapping[str, Any]) -> str:
    """Returns ManiSkill's name of the device that renders its scene: ``none`` if only rays are cast there.

    Args:
        cloud_source: see `lerobot_adamanip.options.CLOUD_SOURCES`.
        render_backend: see `lerobot_adamanip.options.RENDER_BACKENDS`.
        options: of ManiSkill's environment: whoever uses it plainly may look at it.
    """
    plain = options.get("obs_mode") != "none" or options.get("render_mode") is not None
    return MANISKILL_NAMES[resolve_render_backend(render_backend)] if plain or cloud_source == "render" else "none"


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
