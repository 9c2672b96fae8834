"""Files of the environments' repository: modules for LeRobot's EnvHub, requirements and a card."""

from __future__ import annotations

import re
from collections.abc import Sequence

from lerobot_adamanip import __version__
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.versions import SIMULATION_VERSION
from lerobot_adamanip.datasets.cards import (
    COLUMNS,
    LICENSE,
    TAGS,
    card_template,
    front_matter,
    requirement,
    shared_fields,
)
from lerobot_adamanip.evaluation.results import ResultFile
from lerobot_adamanip.hub.model_index import results_table
from lerobot_adamanip.mechanisms.table import RULES
from lerobot_adamanip.util.errors import require_choice

_OBSERVED = {
    schema.POINT_CLOUD: "point_cloud", schema.STATE: "agent_pos", schema.EFFORT: "effort",
    schema.FRONT_IMAGE: "pixels/front", schema.ACTION: "action",
}  # fmt: skip
"""Dataset column -> observation key."""


def environment_files(
    repo_id: str, *, category: str = ALL, results: Sequence[ResultFile] = (), commit: str = ""
) -> dict[str, str]:
    """Returns the files of an environment's repository: name -> text.

    Args:
        repo_id: repository name on the Hub.
        category: category that ``env.py`` opens; `ALL` for all nine. ``envs/`` has one file per category.
        results: results for the card.
        commit: commit of this development version, if known.

    Raises:
        ConfigurationError: the category does not exist.
    """
    require_choice("category", category, (*CATEGORIES, ALL))
    return {
        "env.py": _shim(repo_id, category, commit),
        **{f"envs/{name}.py": _shim(f"{repo_id}:envs/{name}.py", name, commit) for name in CATEGORIES},
        "requirements.txt": _requirements(commit),
        "README.md": _card(repo_id, category, results, commit),
    }


def _card(repo_id: str, category: str, results: Sequence[ResultFile], commit: str) -> str:
    fields = {
        "license": LICENSE,
        "library_name": "lerobot",
        "pipeline_tag": "robotics",
        "tags": sorted({"robotics", "lerobot", "envhub", *TAGS} - {"LeRobot"}),
    }
    return card_template("environment_card.md").substitute(
        front_matter=front_matter("model", fields),
        **_names(repo_id, category),
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
        simulation_version=SIMULATION_VERSION,
        **shared_fields(commit=commit),
    )


def _shim(repo_id: str, category: str, commit: str) -> str:
    install = shared_fields(commit=commit)["install"].removeprefix("# ").replace("\n", ": ")
    return card_template("env.py").substitute(_names(repo_id, category), install=install)


def _names(repo_id: str, category: str) -> dict[str, str]:
    env_type = "adamanip" if category == ALL else f"adamanip_{category}"
    return {"title": _title(category), "repo_id": repo_id, "version": __version__, "env_type": env_type}


def _requirements(commit: str) -> str:
    comments = (f"# {line.removeprefix('# ')}\n" for line in shared_fields(commit=commit)["install"].splitlines())
    return f"{''.join(comments)}{requirement()}\n"


def _title(category: str) -> str:
    return "nine environments" if category == ALL else category.replace("_", " ")
