"""Whether `adamanip collect` records pictures: decided once, before anything is recorded."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from lerobot_adamanip.datasets.collection_spec import CollectionPaths
from lerobot_adamanip.datasets.manifest import stored_images
from lerobot_adamanip.util.errors import GET_PICTURES, ConfigurationError, no_vulkan_device


def can_render() -> bool:
    """Returns whether anything renders on this machine."""
    from lerobot_env_adamanip.sim.render_device import can_render as probe

    return probe()


def require_renderer() -> None:
    """Raises `SimulatorError` if nothing renders on this machine."""
    if not can_render():
        raise no_vulkan_device("no Vulkan driver, or none that takes a picture")


def resolve_images(roots: Sequence[Path], wanted: bool, refused: bool) -> bool:
    """Returns whether a collection has pictures.

    A collection that is there already keeps its own choice; a new one has pictures where something renders, and a line
    on stderr says so where nothing does.

    Args:
        roots: of the dataset, and of parts whose episodes it takes over.
        wanted: --images was given.
        refused: --no-images was given.

    Raises:
        ConfigurationError: both were given.
        SimulatorError: pictures are wanted, and nothing renders here.
    """
    if wanted and refused:
        raise ConfigurationError(
            "Contradicting options.",
            got="--images --no-images",
            allowed="one of them, or neither: pictures where something renders",
            hint="leave one out",
        )
    if refused:
        return False
    stored = [stored_images(CollectionPaths(root.absolute())) for root in roots]
    if not wanted and (known := [each for each in stored if each is not None]):
        return known[0]
    if wanted:
        require_renderer()
    if wanted or can_render():
        return True
    print(
        f"No pictures: nothing renders here. `adamanip render` adds them later. To get them: {GET_PICTURES}.",
        file=sys.stderr,
    )
    return False
