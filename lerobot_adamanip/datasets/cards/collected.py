"""The card of a collected dataset: its README on the Hub."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

from lerobot_adamanip.assets import is_asset_id
from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import is_image_column
from lerobot_adamanip.contract.categories import ALL
from lerobot_adamanip.contract.versions import joined_versions, mixed_versions
from lerobot_adamanip.datasets.attempts import (
    SUCCESS,
    AttemptRecord,
    attempts_path,
    grouped_by_hidden_value,
    read_attempts,
)
from lerobot_adamanip.datasets.cards.templates import LICENSE, TAGS, card_template, citation, front_matter
from lerobot_adamanip.datasets.check.contract import OF_LEROBOT
from lerobot_adamanip.datasets.collect_command import collect_command
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.manifest import Manifest
from lerobot_adamanip.datasets.selection import Selection, selection_path

COLUMNS = {
    schema.POINT_CLOUD: "m; x, y, z of each point, farthest first, so any prefix is itself a farthest-point sample",
    schema.STATE: "tool position, rotation 6D, gripper opening, 7 joint positions [rad], 7 joint velocities [rad/s]",
    schema.EFFORT: "external joint torque [N m]",
    schema.FRONT_IMAGE: "RGB",
    schema.ACTION: "goal: position [m], rotation 6D, gripper (0 closed, 1 open)",
    schema.PHASE: "what the expert is doing: 0 approach, 1 grasp, 2 try, 3 release, 4 unlock, 5 open",
    schema.TRIAL: "failed tries before this row",
    schema.OUTCOME: "of this row's action: 0 reached, 1 stalled, 2 time limit, 3 unreachable",
    schema.TRIED: "joint that this row's action tried to move: 0 the one that opens, 1 and up the others, -1 none",
    schema.FAILED: "whether that try failed: the joint covered less than half of the way it was sent",
    schema.PROGRESS: "how far that joint moved, in the direction it was sent [rad or m]",
    schema.EXECUTED: "what the arm was sent: `action`, but where a policy drove and `action` corrects it",
    schema.JOINTS: "positions of all joints, from which `adamanip render` makes pictures: never a policy's input",
    schema.SUCCESS: "whether the task is done after this row's action",
    schema.DONE: "true in an episode's last row: the final observation; its action stays in place and was not sent",
}
"""Column -> meaning."""
_SIZES = (
    (1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"), (10_000_000, "1M<n<10M"),
    (100_000_000, "10M<n<100M"), (1_000_000_000, "100M<n<1B"),
)  # fmt: skip
"""Number of rows, and the Hub's size category for datasets with fewer rows."""


def dataset_card(folder: Path, name: str, repo_id: str, assets: str | Path | None = None) -> str:
    """Returns the README of a finished dataset. It contains no local path.

    Args:
        folder: of the dataset.
        name: of the output folder in the card's `adamanip collect` command.
        repo_id: its name on the Hub.
        assets: folder of the external assets of the collection, if any.

    Raises:
        DatasetError: the manifest or the list of attempts is damaged, or columns of a collection are missing.
    """
    dataset = Dataset(folder)
    manifest = dataset.manifest(assets) if manifest_path(folder).exists() else None
    attempts = read_attempts(attempts_path(folder)) if manifest is not None else []
    records = [vars(description) for description in dataset.descriptions()]
    selection = dataset.selection if selection_path(folder).exists() else None
    info = dataset.info
    return card_template("dataset_card.md").substitute(
        _made(manifest, records, name.removesuffix("-failed"), selection),
        **_recorded(records),
        **_attempted(None if selection else manifest, attempts, records),
        **_seen(info, records),
        **common_fields(info, name, repo_id, len(records)),
        root_option=" --dataset.root=DIR" if repo_id.startswith("local/") else "",
    )


def common_fields(info: dict[str, Any], name: str, repo_id: str, episodes: int) -> dict[str, object]:
    """Returns the fields of every dataset's card: header, numbers, columns and citation."""
    rows = info["total_frames"]
    size = next((text for most, text in _SIZES if rows < most), "1B<n<10B")
    header = {
        "license": LICENSE,
        "task_categories": ["robotics"],
        "tags": list(TAGS),
        "pretty_name": f"AdaManip demonstrations ({name})",
        "size_categories": [size],
        "configs": [{"config_name": "default", "data_files": "data/*/*.parquet"}],
    }
    columns = [
        f"| `{key}` | {'video, ' if feature['dtype'] == 'video' else ''}{tuple(feature['shape'])} | {_meaning(key)} |"
        for key, feature in info["features"].items()
        if key not in OF_LEROBOT
    ]
    return {
        "front_matter": front_matter("dataset", header),
        "repo_id": repo_id,
        "episodes": episodes,
        "frames": rows,
        "key_frames": rows - episodes,
        "features": "\n".join(columns),
        "fps": info["fps"],
        "citation": citation(),
    }


def _made(
    manifest: Manifest | None, records: list[dict[str, Any]], folder: str, selection: Selection | None
) -> dict[str, str]:
    """Returns the fields about how the dataset was made."""
    categories = list(dict.fromkeys(category_of(record["object_id"]) for record in records))
    together = len(categories) > 1 if manifest is None else manifest.spec.category == ALL
    made = "Put together of several collections, or of a part of one: each episode's columns say how it was made."
    if manifest is not None:
        made = f"```bash\n{collect_command(manifest.spec, 'DATASET' if selection else folder)}\n```"
    if selection is not None:
        commands = "\n".join(selection.made_with)
        told = f", made with\n\n```bash\n{commands}\n```" if commands else "."
        part = f"Part of `DATASET`: {len(selection.episodes)} of its {selection.source_episodes} episodes"
        made = f"{part}, listed in `meta/selection.json`{told}\n\nHow `DATASET` was made:\n\n{made}"
    return {
        "title": "all categories" if together else categories[0].replace("_", " "),
        "env_type": "adamanip" if together else f"adamanip_{categories[0]}",
        "expert": "/".join(sorted({str(record["expert"]) for record in records})),
        "made": made,
    }


def _meaning(column: str) -> str:
    return COLUMNS.get(schema.FRONT_IMAGE if is_image_column(column) else column, "")


def _seen(info: dict[str, Any], records: list[dict[str, Any]]) -> dict[str, object]:
    """Returns the fields about camera and objects."""
    picture = info["features"].get(schema.FRONT_IMAGE)
    if picture is None:
        pictures = "There are no pictures (`adamanip render` adds them)"
    else:
        height, width = picture["shape"][:2]
        pictures = f"Pictures (`{schema.FRONT_IMAGE}`) have {width} x {height} pixels, RGB"
    poses = {json.dumps(record["camera"].get("extrinsics", record["camera"]), sort_keys=True) for record in records}
    moves = "its pose is drawn anew for each episode" if len(poses) > 1 else "its pose is the same in all episodes"
    external = any(is_asset_id(str(record["object_id"])) for record in records)
    objects = " from external models" if external else ", generated from parameters"
    return {"pictures": pictures, "camera_pose": moves, "kind_of_objects": objects}


def _recorded(records: list[dict[str, Any]]) -> dict[str, object]:
    """Returns the counts of episodes."""
    successes = sum(bool(record["success"]) for record in records)
    tries = Counter(record["failed_tries"] for record in records)
    opened = Counter(record["failed_tries"] for record in records if record["success"])
    kept = {0: "Only episodes that failed are in it", len(records): "Only episodes that ended in success are in it"}
    versions = [record["versions"] for record in records]
    mixed = mixed_versions({**each, "cpu": ""} for each in versions)
    return {
        "split": "" if successes else ", failed episodes",
        "kept": kept.get(successes, f"{successes} of its episodes ended in success"),
        "objects": len({record["object_id"] for record in records}),
        "late": sum(record["late"] for record in records),
        "recovered": sum(count for failed, count in opened.items() if failed),
        "trial_table": "\n".join(f"| {failed} | {tries[failed]} | {opened[failed]} |" for failed in sorted(tries)),
        "versions": ", ".join(f"{name} {version}" for name, version in sorted(joined_versions(versions).items())),
        "mixed": f" Mind: its episodes were recorded with different versions: {mixed}." if mixed else "",
    }


def _attempted(
    manifest: Manifest | None, attempts: list[AttemptRecord], records: list[dict[str, Any]]
) -> dict[str, object]:
    """Returns the counts of the collection's attempts, or of the episodes if the attempts are unknown."""
    counts = None if manifest is None else manifest.attempts
    if counts is None:
        attempts = [_as_attempt(record) for record in records]
        account = "the source collections list the attempts"
        rows = ["| hidden | episodes | of them succeeded |", "|---|---|---|"]
    else:
        succeeded = sum(attempt.success for attempt in attempts)
        account = (
            f"for the collection {counts.attempted} episodes were attempted: {succeeded} "
            f"({100.0 * succeeded / max(1, counts.attempted):.1f} %) succeeded,\n{counts.kept} were kept, and "
            f"{counts.given_up} wanted episodes were given up"
        )
        rows = ["| hidden | attempted | of them succeeded | of them kept |", "|---|---|---|---|"]
    for label, group in grouped_by_hidden_value(attempts).items():
        kept = f" {sum(each.kept for each in group)} |" if counts is not None else ""
        rows.append(f"| `{label}` | {len(group)} | {sum(each.success for each in group)} |{kept}")
    return {"account": account, "hidden_table": "\n".join(rows)}


def _as_attempt(record: dict[str, Any]) -> AttemptRecord:
    """Returns an episode as an attempt, for datasets whose other attempts are unknown."""
    facts = {key: record[key] for key in ("object_id", "slot", "attempt", "seed", "hidden_state", "late")}
    return AttemptRecord(**facts, kept=True, reason=SUCCESS if record["success"] else "no success", key_frames=0)
