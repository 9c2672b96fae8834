"""Cards for the Hub, filled in from the templates of ``hub_cards/``."""

from __future__ import annotations

import importlib.resources
import json
from collections import Counter
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from lerobot_adamanip import schema
from lerobot_adamanip.categories import ALL
from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.fingerprint import combined

if TYPE_CHECKING:
    from lerobot_adamanip.demos.attempts import AttemptRecord
    from lerobot_adamanip.demos.collection import CollectionSpec
    from lerobot_adamanip.demos.manifest import Manifest

LICENSE = "apache-2.0"
TAGS = ("LeRobot", "lerobot_env_adamanip", "adamanip", "point-cloud", "articulated-objects", "simulation")
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
    schema.SUCCESS: "whether the task is done after this row's action",
    schema.DONE: "true in an episode's last row: the final observation; its action stays in place and was not sent",
}
"""What a column means."""
_OF_LEROBOT = ("timestamp", "frame_index", "episode_index", "index", "task_index")


def card_template(name: str) -> Template:
    """Returns a template of ``hub_cards/``: beside the package in a checkout, inside it in a wheel."""
    package = importlib.resources.files("lerobot_adamanip")
    candidates: list[Traversable] = [package / "hub_cards" / name]
    if isinstance(package, Path):
        candidates.append(package.parent / "hub_cards" / name)
    for candidate in candidates:
        if candidate.is_file():
            return Template(candidate.read_text(encoding="utf-8"))
    raise ConfigurationError(
        "A card template is missing.",
        got=name,
        allowed=", ".join(map(str, candidates)),
        hint="pip install --force-reinstall lerobot_env_adamanip",
    )


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
    from lerobot_adamanip.demos.attempts import by_hidden_value

    info = json.loads((folder / "meta" / "info.json").read_text())
    spec, counts = manifest.spec, manifest.attempts
    assert counts is not None
    failed = not any(record["success"] for record in records)
    tries = Counter(record["failed_tries"] for record in records)
    return card_template("dataset_card.md").substitute(
        tags="\n".join(f"  - {tag}" for tag in TAGS),
        license=LICENSE,
        repo_id=repo_id,
        title="all categories" if spec.category == ALL else spec.category.replace("_", " "),
        split=", failed episodes" if failed else "",
        kept="Only episodes that failed are in it" if failed else "Only episodes that ended in success are in it",
        env_type="adamanip" if spec.category == ALL else f"adamanip_{spec.category}",
        expert=spec.expert,
        episodes=len(records),
        frames=info["total_frames"],
        objects=len({record["object_id"] for record in records}),
        features=_features(info["features"]),
        fps=info["fps"],
        attempted=counts.attempted,
        successes=counts.kept,
        given_up=counts.given_up,
        success_rate=f"{100.0 * counts.kept / max(1, counts.attempted):.1f}",
        late=sum(record["late"] for record in records),
        trial_table="\n".join(f"| {count} | {tries[count]} |" for count in sorted(tries)),
        hidden_table="\n".join(
            f"| `{label}` | {kept} | {tried} |" for label, (kept, tried) in by_hidden_value(attempts).items()
        ),
        fingerprint=combined(manifest.fingerprint),
        fingerprint_table="\n".join(f"| {part} | `{value}` |" for part, value in sorted(manifest.fingerprint.items())),
        versions=", ".join(f"{name} {version}" for name, version in sorted(records[0]["versions"].items())),
        command=command(spec, name.removesuffix("-failed")),
    )


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
        "poses": environment.poses,
        "mechanism_preset": environment.mechanism_preset,
        "trials": spec.trials,
        "late_starts": spec.late_starts,
        "seed": spec.seed,
        "root": folder,
    }
    flags = "".join(f" --{name.replace('_', '-')} {value}" for name, value in options.items())
    external = " --assets DIR" if environment.assets is not None else ""
    return f"adamanip collect{flags}{external}{' --keep-failed' if spec.keep_failed else ''}"
