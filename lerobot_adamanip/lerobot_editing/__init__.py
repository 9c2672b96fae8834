"""Importing this mends `lerobot-edit-dataset` for datasets with clouds.

LeRobot's editing command loads no plugins by itself; it imports what it is told to::

    lerobot-edit-dataset --discover_packages_path=lerobot_adamanip.lerobot_editing ...
"""

from lerobot_adamanip.lerobot_editing.mend import apply, is_tested, restore

apply()

__all__ = ["apply", "is_tested", "restore"]
