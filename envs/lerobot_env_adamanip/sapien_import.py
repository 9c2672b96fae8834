"""Keeps SAPIEN at the kinematics library that comes with it.

SAPIEN takes any package `pinocchio` that is installed (`pin`, which LeRobot's kinematics and other simulators bring) in
place of its own build of it. Postures then differ in their last digits, contacts turn those into other episodes, and
nothing says so: the same seed no longer gives the same episode, and each solve takes longer.
"""

from __future__ import annotations

import logging
import sys
import warnings

from lerobot_adamanip.util.errors import no_simulator

LIBRARY = "pinocchio"
_OWN = "sapien.pysapien_pinocchio"
_log = logging.getLogger(__name__)


def import_sapien() -> None:
    """Imports SAPIEN with its own kinematics. Warns if somebody has imported it before, with others.

    Raises:
        SimulatorError: SAPIEN is not installed.
    """
    if "sapien" not in sys.modules:
        with warnings.catch_warnings():
            # Physics needs no Vulkan library, and whoever wants pictures without one gets an error that says more.
            warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
            try:
                _import_without(LIBRARY)
            except ImportError as error:
                raise no_simulator(error) from error
    from sapien.wrapper.pinocchio_model import PinocchioModel

    if PinocchioModel.__module__ != _OWN:
        _log.warning(
            "SAPIEN was imported with the installed package %s: episodes are not those of the same seeds elsewhere. "
            "Import lerobot_env_adamanip's environments first, or pip uninstall pin.",
            LIBRARY,
        )


def _import_without(name: str) -> None:
    """Imports SAPIEN as if there were no package of this name."""
    missing = object()
    before = sys.modules.get(name, missing)
    sys.modules[name] = None  # type: ignore[assignment]  # Python's way to say that there is no such module
    try:
        import sapien  # noqa: F401
    finally:
        del sys.modules[name]
        if before is not missing:
            sys.modules[name] = before  # type: ignore[assignment]
