"""External assets: folders with a ``mobility.urdf``, in AdaManip's, UniDoorManip's or PartNet-Mobility's layout.

An external asset's id is ``<category>:<folder name>``, ``safe:sa1``; a generated one's, ``safe_001``, has no colon.
Nothing of those collections is shipped: users who have them point ``--env.assets=DIR`` at their folder.
"""

from __future__ import annotations

from lerobot_adamanip.assets.source import (
    AssetReport,
    AssetSource,
    PlacementCheck,
    load_object,
    parse_asset_id,
)
from lerobot_adamanip.contract.categories import is_asset_id

__all__ = ["AssetReport", "AssetSource", "PlacementCheck", "is_asset_id", "load_object", "parse_asset_id"]
