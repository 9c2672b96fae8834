"""Import of SAPIEN with its own kinematics library."""

from __future__ import annotations

import logging
import sys
import warnings
from typing import Any

from lerobot_adamanip.util.errors import no_simulator

KINEMATICS_LIBRARY = "pinocchio"
_log = logging.getLogger(__name__)


def import_sapien() -> None:
    """Imports SAPIEN with its own kinematics library; warns if another one was imported before.

    SAPIEN prefers an installed `pinocchio` (from `pin`, a dependency of LeRobot's kinematics) to its own build.
    Postures then differ in their last digits, contacts amplify this, and the same seed gives another episode.

    Raises:
        SimulatorError: SAPIEN is not installed.
    """
    if "sapien" not in sys.modules:
        with warnings.catch_warnings():
            # Physics needs no Vulkan library, and rendering without one raises a clearer error later.
            warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
            modules: dict[str, Any] = sys.modules
            before = {name: modules[name] for name in (KINEMATICS_LIBRARY,) if name in modules}
            modules[KINEMATICS_LIBRARY] = None  # Python's marker for a module that cannot be imported
            try:
                import sapien  # noqa: F401
            except ImportError as error:
                raise no_simulator(error) from error
            finally:
                del modules[KINEMATICS_LIBRARY]
                modules.update(before)
    from sapien.wrapper.pinocchio_model import PinocchioModel

    if PinocchioModel.__module__ != "sapien.pysapien_pinocchio":
        _log.warning(
            "SAPIEN was imported with the installed package %s: episodes are not those of the same seeds elsewhere. "
            "Import lerobot_env_adamanip's environments first, or pip uninstall pin.",
            KINEMATICS_LIBRARY,
        )
