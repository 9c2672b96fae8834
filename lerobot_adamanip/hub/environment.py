"""Repository of the environments: a shim for LeRobot's EnvHub, its card, and its requirements."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from lerobot_adamanip import __version__
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.datasets.cards.collected import COLUMNS
from lerobot_adamanip.datasets.cards.templates import LICENSE, TAGS, card_template, citation, front_matter
from lerobot_adamanip.evaluation.results import ResultFile
from lerobot_adamanip.hub.model_index import results_table
from lerobot_adamanip.mechanisms.table import RULES
from lerobot_adamanip.util.errors import require_choice
from lerobot_adamanip.util.fingerprint import combined

_OBSERVED = {
    schema.POINT_CLOUD: "point_cloud", schema.STATE: "agent_pos", schema.EFFORT: "effort",
    schema.FRONT_IMAGE: "pixels/front", schema.ACTION: "action",
}  # fmt: skip
"""Column of a dataset -> what the environment calls it."""


def write_environment(
    folder: Path,
    repo_id: str,
    fingerprint: Mapping[str, str],
    *,
    category: str = ALL,
    results: Sequence[ResultFile] = (),
) -> None:
    """Writes the files of an environment's repository.

    Args:
        folder: an empty one.
        repo_id: its name on the Hub.
        fingerprint: part -> hash of the code that decides episodes.
        category: what ``env.py`` opens; `ALL` for the suite. There is a file for each under ``envs/``.
        results: for its card.

    Raises:
        ConfigurationError: there is no such category.
    """
    require_choice("category", category, (*CATEGORIES, ALL))
    (folder / "envs").mkdir(parents=True)
    (folder / "env.py").write_text(_shim(repo_id, category), encoding="utf-8")
    for name in CATEGORIES:
        (folder / "envs" / f"{name}.py").write_text(_shim(f"{repo_id}:envs/{name}.py", name), encoding="utf-8")
    (folder / "requirements.txt").write_text(f"lerobot_env_adamanip[sim]=={__version__}\n", encoding="utf-8")
    card = environment_card(repo_id, fingerprint, category=category, results=results)
    (folder / "README.md").write_text(card, encoding="utf-8")


def environment_card(
    repo_id: str, fingerprint: Mapping[str, str], *, category: str = ALL, results: Sequence[ResultFile] = ()
) -> str:
    """Returns the README of an environment's repository; arguments as of `write_environment`."""
    fields = {
        "license": LICENSE,
        "library_name": "lerobot",
        "pipeline_tag": "robotics",
        "tags": sorted({"robotics", "lerobot", "envhub", *TAGS} - {"LeRobot"}),
    }
    return card_template("environment_card.md").substitute(
        front_matter=front_matter("model", fields),
        title=_title(category),
        repo_id=repo_id,
        version=__version__,
        env_type=_env_type(category),
        opens="all nine categories: {category: {0: vector environment}}" if category == ALL else _title(category),
        categories="\n".join(
            f"| {name.replace('_', ' ')} | {each.seen} | {re.split('[:;] ', RULES[name].reading)[0]} |"
            for name, each in CATEGORIES.items()
        ),
        features="\n".join(
            f"| `{_OBSERVED[key]}` | {tuple(feature['shape'])} | {COLUMNS[key]} |"
            for key, feature in schema.dataset_features().items()
            if key in _OBSERVED
        ),
        results=results_table(results),
        fingerprint=combined(fingerprint),
        fingerprint_table="\n".join(f"| {part} | `{value}` |" for part, value in sorted(fingerprint.items())),
        citation=citation(),
    )


def _title(category: str) -> str:
    return "nine environments" if category == ALL else category.replace("_", " ")


def _env_type(category: str) -> str:
    return "adamanip" if category == ALL else f"adamanip_{category}"


def _shim(repo_id: str, category: str) -> str:
    return card_template("env.py").substitute(
        title=_title(category), repo_id=repo_id, version=__version__, env_type=_env_type(category)
    )
