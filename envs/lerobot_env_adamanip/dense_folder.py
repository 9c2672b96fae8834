"""Output folder of a dense collection: checked before it is recorded to, or gone on with."""

from __future__ import annotations

import json
from pathlib import Path

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.datasets.collection_spec import CollectionSpec, EpisodeSpec, episode_seed
from lerobot_adamanip.datasets.output_folder import WRITING, is_free, owned_output
from lerobot_adamanip.hardware.features import KEY_FRAMES
from lerobot_adamanip.util.errors import DatasetError

ROBOT_TYPE = "adamanip_dense"
"""Of such recordings."""
_MOST_ATTEMPTS = 100
"""Attempts per episode at most whose seeds are known again."""


def claimed(target: Path, spec: CollectionSpec) -> Path:
    """Returns where to record, checked; the recording locks it itself."""
    with owned_output(target, WRITING) as output:
        if not is_free(output.root):
            require_same_recording(output.root, spec)
        else:
            output.require_free()
            if output.root.exists():
                output.root.rmdir()  # LeRobot makes it
    return output.root


def require_same_recording(root: Path, spec: CollectionSpec) -> None:
    """Raises `DatasetError` unless the episodes of a recording are the first ones of a collection."""
    try:
        info = json.loads((root / "meta" / "info.json").read_text(encoding="utf-8"))
        if (info["robot_type"], info["total_episodes"]) == (ROBOT_TYPE, 0):
            return  # killed before the first episode was saved
        lines = (root / KEY_FRAMES).read_text(encoding="utf-8").splitlines()
        found = [(known["object_id"], known["seed"]) for known in map(json.loads, lines)]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _another_recording(root, f"no dense collection: {type(error).__name__}") from error
    items = spec.items()
    for number, (object_id, seed) in enumerate(found):
        item = items[number] if number < len(items) else None
        if item is None or object_id != item.object_id or seed not in _seeds(spec, item):
            raise _another_recording(root, f"episode {number} is of {object_id}, seed {seed}")


def _seeds(spec: CollectionSpec, item: EpisodeSpec) -> set[int]:
    category = category_of(item.object_id)
    return {episode_seed(spec.seed, category, item.object_id, item.slot, number) for number in range(_MOST_ATTEMPTS)}


def _another_recording(root: Path, got: str) -> DatasetError:
    return DatasetError(
        "There is something else at the root of the recording.",
        got=f"{root}: {got}",
        allowed="a folder that does not exist, is empty, or was recorded with the same options",
        hint="another folder",
    )
