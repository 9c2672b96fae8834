"""The card of a dataset: its README on the Hub, with the numbers that are true of it."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

from lerobot_adamanip import schema
from lerobot_adamanip.categories import ALL
from lerobot_adamanip.demos.attempts import AttemptRecord, by_hidden_value
from lerobot_adamanip.demos.collection import CollectionSpec
from lerobot_adamanip.demos.manifest import Manifest
from lerobot_adamanip.fingerprint import combined
from lerobot_adamanip.hub.cards import LICENSE, TAGS, card_template

COLUMNS = {
    schema.POINT_CLOUD: "m; in farthest-point order, so any prefix is itself a farthest-point sample",
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
"""What a column means."""
_OF_LEROBOT = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def dataset_card(
    folder: Path,
    name: str,
    *,
    manifest: Manifest,
    records: list[dict[str, Any]],
    attempts: list[AttemptRecord],
    repo_id: str,
) -> str:
    """Returns the README of a dataset, with the numbers that are true of it. It holds no path of this machine.

    Args:
        folder: that the dataset is in.
        name: that its folder will have.
        manifest: of the collection.
        records: of its episodes.
        attempts: all that were made for the collection.
        repo_id: its name on the Hub.
    """
    info = json.loads((folder / "meta" / "info.json").read_text())
    return card_template("dataset_card.md").substitute(
        _collected(manifest.spec, name.removesuffix("-failed")),
        **_recorded(records),
        **_attempted(manifest, attempts),
        tags="\n".join(f"  - {tag}" for tag in TAGS),
        license=LICENSE,
        repo_id=repo_id,
        frames=info["total_frames"],
        features=_features(info["features"]),
        fps=info["fps"],
        fingerprint=combined(manifest.fingerprint),
        fingerprint_table="\n".join(f"| {part} | `{value}` |" for part, value in sorted(manifest.fingerprint.items())),
    )


def _collected(spec: CollectionSpec, folder: str) -> dict[str, str]:
    """Returns the fields of a card that say what was asked for."""
    together = spec.category == ALL
    return {
        "title": "all categories" if together else spec.category.replace("_", " "),
        "env_type": "adamanip" if together else f"adamanip_{spec.category}",
        "expert": spec.expert,
        "command": command(spec, folder),
    }


def _recorded(records: list[dict[str, Any]]) -> dict[str, object]:
    """Returns the fields of a card that count the dataset's episodes."""
    failed = not any(record["success"] for record in records)
    tries = Counter(record["failed_tries"] for record in records)
    return {
        "split": ", failed episodes" if failed else "",
        "kept": "Only episodes that failed are in it" if failed else "Only episodes that ended in success are in it",
        "episodes": len(records),
        "objects": len({record["object_id"] for record in records}),
        "late": sum(record["late"] for record in records),
        "trial_table": "\n".join(f"| {count} | {tries[count]} |" for count in sorted(tries)),
        "versions": ", ".join(f"{name} {version}" for name, version in sorted(records[0]["versions"].items())),
    }


def _attempted(manifest: Manifest, attempts: list[AttemptRecord]) -> dict[str, object]:
    """Returns the fields of a card that count all attempts of the collection."""
    counts = manifest.attempts
    assert counts is not None
    rows = (f"| `{label}` | {kept} | {tried} |" for label, (kept, tried) in by_hidden_value(attempts).items())
    return {
        "attempted": counts.attempted,
        "successes": counts.kept,
        "given_up": counts.given_up,
        "success_rate": f"{100.0 * counts.kept / max(1, counts.attempted):.1f}",
        "hidden_table": "\n".join(rows),
    }


def _features(features: dict[str, Any]) -> str:
    """Returns a table of a dataset's columns; raises KeyError for one that nobody has described."""
    rows = [
        f"| `{key}` | {'video, ' if feature['dtype'] == 'video' else ''}{tuple(feature['shape'])} | {COLUMNS[key]} |"
        for key, feature in features.items()
        if key not in _OF_LEROBOT
    ]
    return "\n".join(rows)


def command(spec: CollectionSpec, folder: str) -> str:
    """Returns the command that collects a dataset of these options, into ``folder``."""
    environment = spec.environment
    options: dict[str, object] = {
        "category": spec.category,
        "objects": ",".join(spec.objects),
        "expert": spec.expert,
        "expert_preset": spec.expert_preset,
        "episodes_per_object": spec.episodes_per_object,
        "num_points": environment.num_points,
        "cloud_source": environment.cloud_source,
        "poses": environment.poses,
        "mechanism_preset": environment.mechanism_preset,
        "trials": spec.trials,
        "late_starts": spec.late_starts,
        "seed": spec.seed,
        "root": folder,
    }
    flags = "".join(f" --{name.replace('_', '-')} {value}" for name, value in options.items())
    external = " --assets DIR" if environment.assets is not None else ""
    images = "" if environment.observe_images else " --no-images"
    return f"adamanip collect{flags}{external}{images}{' --keep-failed' if spec.keep_failed else ''}"
