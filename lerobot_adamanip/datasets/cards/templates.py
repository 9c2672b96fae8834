"""Cards for the Hub: the templates of ``hub_cards/``, what every card says, and a check that needs no network."""

from __future__ import annotations

import importlib.resources
import re
from collections.abc import Iterator, Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template
from typing import Any

from lerobot_adamanip.util.errors import ConfigurationError, DatasetError

LICENSE = "apache-2.0"
TAGS = ("LeRobot", "lerobot_env_adamanip", "adamanip", "point-cloud", "articulated-objects", "simulation")
TEMPLATES = ("dataset_card.md", "recorded_card.md", "model_card.md", "environment_card.md", "citation.md", "env.py")
LICENSES = {
    "afl-3.0", "agpl-3.0", "apache-2.0", "artistic-2.0", "bigcode-openrail-m", "bigscience-bloom-rail-1.0",
    "bigscience-openrail-m", "bsd", "bsd-2-clause", "bsd-3-clause", "bsd-3-clause-clear", "bsl-1.0", "c-uda", "cc",
    "cc-by-2.0", "cc-by-2.5", "cc-by-3.0", "cc-by-4.0", "cc-by-nc-2.0", "cc-by-nc-3.0", "cc-by-nc-4.0",
    "cc-by-nc-nd-3.0", "cc-by-nc-nd-4.0", "cc-by-nc-sa-2.0", "cc-by-nc-sa-3.0", "cc-by-nc-sa-4.0", "cc-by-nd-4.0",
    "cc-by-sa-3.0", "cc-by-sa-4.0", "cc0-1.0", "cdla-permissive-1.0", "cdla-permissive-2.0", "cdla-sharing-1.0",
    "creativeml-openrail-m", "ecl-2.0", "epl-1.0", "epl-2.0", "etalab-2.0", "eupl-1.1", "eupl-1.2", "gemma", "gfdl",
    "gpl", "gpl-2.0", "gpl-3.0", "isc", "lgpl", "lgpl-2.1", "lgpl-3.0", "llama2", "llama3", "llama3.1", "llama3.2",
    "llama3.3", "lppl-1.3c", "mit", "mpl-2.0", "ms-pl", "ncsa", "odbl", "odc-by", "ofl-1.1", "openrail", "openrail++",
    "osl-3.0", "other", "pddl", "postgresql", "unknown", "unlicense", "wtfpl", "zlib",
}  # fmt: skip
"""Identifiers of licences that the Hub takes."""
_KEYS = {
    "dataset": {"license", "task_categories", "tags", "configs", "pretty_name", "size_categories", "language"},
    "model": {
        "license", "library_name", "pipeline_tag", "tags", "datasets", "base_model", "model_name", "model-index",
        "language",
    },
}  # fmt: skip
"""What may stand in a card's header; the Hub drops misspelt keys without a word."""


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


def template_texts() -> Iterator[str]:
    """Yields the text of every template."""
    return (card_template(name).template for name in TEMPLATES)


def citation() -> str:
    """Returns what every card ends with: whom to cite, and whose code and objects these are not."""
    return card_template("citation.md").template.strip()


def front_matter(kind: str, fields: Mapping[str, Any]) -> str:
    """Returns a card's header of YAML, made by the Hub's own library.

    Args:
        kind: ``dataset`` or ``model``.
        fields: of ``DatasetCardData`` or ``ModelCardData``; ``eval_results`` become ``model-index``.
    """
    from huggingface_hub import DatasetCardData, ModelCardData

    data = (DatasetCardData if kind == "dataset" else ModelCardData)(**fields)
    return f"---\n{data.to_yaml().strip()}\n---"


def check_card(text: str, kind: str) -> None:
    """Checks a card without the Hub, whose own check is made when it is uploaded.

    Args:
        text: of the card.
        kind: ``dataset`` or ``model``.

    Raises:
        DatasetError: its header is no YAML, holds a key that the Hub does not know, an unknown licence, a malformed
            ``model-index`` or name; or a placeholder was left in it.
    """
    try:
        _check(text, kind)
    except ValueError as error:
        raise DatasetError(
            "The card is not valid.",
            got=str(error)[:400],
            allowed="a header that the Hub understands",
            hint="README.md",
        ) from error


def _check(text: str, kind: str) -> None:
    import yaml
    from huggingface_hub import DatasetCard, ModelCard
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]

    found = re.match(r"---\r?\n(.*?)\r?\n---\r?\n", text, re.DOTALL)
    if found is None:
        raise ValueError("no header between lines of ---")
    try:
        header = yaml.safe_load(found[1])
    except yaml.YAMLError as error:
        raise ValueError(f"its header is no YAML: {error}") from error
    if not isinstance(header, dict):
        raise ValueError("its header is no mapping")
    if unknown := sorted(map(str, set(header) - _KEYS[kind])):
        raise ValueError(f"unknown keys: {', '.join(unknown)}")
    if header.get("license") not in LICENSES:
        raise ValueError(f"license {header.get('license')!r}")
    if not all(isinstance(tag, str) for tag in header.get("tags") or [None]):
        raise ValueError("tags are no list of words")
    for name in _listed(header.get("datasets")):
        validate_repo_id(name)
    (DatasetCard if kind == "dataset" else ModelCard)(text)  # reads model-index strictly
    if left := re.search(r"\$[a-z_]+\b", text[found.end() :]):
        raise ValueError(f"the placeholder {left.group()} was left")


def _listed(value: Any) -> list[str]:
    return [] if value is None else [value] if isinstance(value, str) else list(value)
