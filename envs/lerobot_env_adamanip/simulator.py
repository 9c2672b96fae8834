"""Start of the simulator. Importing this module does not import the simulator."""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util
from typing import TYPE_CHECKING, Any, cast

import gymnasium as gym

from lerobot_adamanip.assets import PlacementCheck
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_env_adamanip.sim.render_device import resolve_cloud_source

if TYPE_CHECKING:
    from lerobot_env_adamanip.sim.tasks import AdaManipTask


def require_simulator() -> None:
    """Imports the simulator and registers the tasks; raises `SimulatorError` if it is not installed."""
    import lerobot_env_adamanip.sim.tasks  # noqa: F401


def make_task(category: str, **options: Any) -> AdaManipTask:
    """Builds the ManiSkill task of a category, without ManiSkill's own observations.

    Raises:
        SimulatorError: the simulator is not installed.
    """
    require_simulator()
    task = gym.make(CATEGORIES[category].task_id, obs_mode="none", reward_mode="none", **options).unwrapped
    return cast("AdaManipTask", task)


@functools.cache
def placement_check(poses: str = "randomized") -> PlacementCheck:
    """Returns a check: object -> why it cannot be placed in front of the arm, or an empty text.

    Args:
        poses: see `lerobot_adamanip.episode.options.POSES`.

    Raises:
        SimulatorError: the simulator is not installed.
    """
    require_simulator()
    from lerobot_env_adamanip.sim import placement
    from lerobot_env_adamanip.sim.tasks import TASKS

    return lambda obj: placement.placement_check(TASKS[obj.category].definition, poses)(obj)


def sensors_name(options: EnvironmentOptions) -> str:
    """Returns the sources of observations: embreex and its version, the renderer's devices, or both."""
    if importlib.util.find_spec("sapien") is None or importlib.util.find_spec("mani_skill") is None:
        require_simulator()
    rays = resolve_cloud_source(options.cloud_source) == "raycast"
    names = [f"embreex {importlib.metadata.version('embreex')}"] if rays else []
    if options.observe_images or not rays:
        from lerobot_env_adamanip.sim.sapien_import import import_sapien

        import_sapien()
        from lerobot_env_adamanip.sim.renderer import renderer_name

        names.append(renderer_name())
    return "; ".join(names)
