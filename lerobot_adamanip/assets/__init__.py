"""External assets: folders with a ``mobility.urdf``, in AdaManip's, UniDoorManip's or PartNet-Mobility's layout.

The id of an external asset is ``<category>:<folder name>``, ``safe:sa1``; ids of generated objects (``safe_001``) have
no colon. These collections are not included: users point ``--env.assets=DIR`` at their copy.
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
