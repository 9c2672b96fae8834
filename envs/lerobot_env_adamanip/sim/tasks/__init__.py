"""Plain ManiSkill: importing this registers all tasks; then ``gymnasium.make("AdaManip-Safe-v1")`` creates one.

The classes, such as `SafeTask`, are created from the table in `categories` and can be imported from here.
"""

from lerobot_adamanip.util.errors import no_simulator
from lerobot_env_adamanip.sim.sapien_import import import_sapien

import_sapien()  # before ManiSkill imports it

try:
    from lerobot_env_adamanip.sim.tasks.base import AdaManipTask
except ImportError as error:
    raise no_simulator(error) from error
from lerobot_env_adamanip.sim.tasks.categories import CLASSES, TASKS  # noqa: E402


def __getattr__(name: str) -> type[AdaManipTask]:
    """Returns a task class by name."""
    if name in CLASSES:
        return CLASSES[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["TASKS", "AdaManipTask", *CLASSES]  # noqa: PLE0604  (class names from the table)
