"""Whether observations hold pictures: as asked for, or where this machine renders."""

from __future__ import annotations

import logging

from lerobot_adamanip.util.errors import GET_PICTURES, no_vulkan_device
from lerobot_env_adamanip.sim.render_device import can_render

_log = logging.getLogger(__name__)


def observes_images(wanted: bool | None) -> bool:
    """Returns whether observations hold pictures.

    Args:
        wanted: the option; None for pictures where something renders, and a warning where nothing does.

    Raises:
        SimulatorError: pictures are wanted, and nothing renders here.
    """
    if wanted is False or can_render():
        return wanted is not False
    if wanted:
        raise no_vulkan_device("no Vulkan driver, or none that takes a picture")
    _log.warning(
        "Observations hold no pictures: nothing renders here. Policies of clouds do without. A policy that looks at "
        "pictures needs --env.observe_images=true, and a renderer: %s.",
        GET_PICTURES,
    )
    return False
