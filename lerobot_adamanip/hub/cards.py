"""Cards for the Hub, filled in from the templates of ``hub_cards/``."""

from __future__ import annotations

import importlib.resources
import json
from collections import Counter
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template
from typing import Any

from lerobot_adamanip.categories import ALL
from lerobot_adamanip.demos.collection import CollectionSpec
from lerobot_adamanip.errors import ConfigurationError

LICENSE = "apache-2.0"
TAGS = ("LeRobot", "lerobot_env_adamanip", "adamanip", "point-cloud", "articulated-objects", "simulation")


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


def dataset_card(root: Path, options: CollectionSpec, records: list[dict[str, Any]], repo_id: str) -> str:
    """Returns the README of a dataset, with the numbers that are true of it."""
    info = json.loads((root / "meta" / "info.json").read_text())
    attempts = sum(record["attempts"] for record in records)
    trials = Counter(record["trials"] for record in records)
    return card_template("dataset_card.md").substitute(
        tags="\n".join(f"  - {tag}" for tag in TAGS),
        license=LICENSE,
        repo_id=repo_id,
        title="all categories" if options.category == ALL else options.category.replace("_", " "),
        env_type="adamanip" if options.category == ALL else f"adamanip_{options.category}",
        expert=options.expert,
        episodes=len(records),
        frames=info["total_frames"],
        objects=len({record["object_id"] for record in records}),
        num_points=options.num_points,
        image_size=options.image_size,
        fps=info["fps"],
        seed=options.seed,
        trials=options.trials,
        attempts=attempts,
        success_rate=f"{100.0 * len(records) / attempts:.1f}",
        trial_table="\n".join(f"| {count} | {trials[count]} |" for count in sorted(trials)),
        versions=", ".join(f"{name} {version}" for name, version in sorted(records[0]["versions"].items())),
        command=_command(options, root.name.removesuffix(".assembling")),
    )


def _command(options: CollectionSpec, folder: str) -> str:
    presets = {**options.env_options, **{f"expert_{name}": value for name, value in options.expert_options.items()}}
    return (
        f"adamanip collect --category {options.category} --expert {options.expert} "
        f"--episodes-per-object {options.episodes_per_object} --num-points {options.num_points} "
        f"--trials {options.trials} --seed {options.seed} --objects {','.join(options.objects)} --root {folder}"
        + "".join(f" --{name.replace('_', '-')} {value}" for name, value in sorted(presets.items()))
    )
