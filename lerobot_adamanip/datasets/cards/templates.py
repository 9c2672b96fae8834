"""Templates of cards for the Hub, from ``hub_cards/``, and a check of cards that needs no network."""

from __future__ import annotations

import importlib.resources
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from string import Template
from typing import Any

from lerobot_adamanip.util.errors import DatasetError

LICENSE = "apache-2.0"
TAGS = ("LeRobot", "lerobot_env_adamanip", "adamanip", "point-cloud", "articulated-objects", "simulation")
TEMPLATES = ("dataset_card.md", "recorded_card.md", "model_card.md", "environment_card.md", "citation.md", "env.py")


def card_template(name: str) -> Template:
    """Returns a template of ``hub_cards/``: beside the package in a checkout, inside it in a wheel."""
    package = importlib.resources.files("lerobot_adamanip")
    template = package / "hub_cards" / name
    if isinstance(package, Path) and not template.is_file():
        template = package.parent / "hub_cards" / name
    return Template(template.read_text(encoding="utf-8"))


def template_texts() -> Iterator[str]:
    """Yields the text of every template."""
    return (card_template(name).template for name in TEMPLATES)


def citation() -> str:
    """Returns the end of every card: citation, and whose code and objects these are not."""
    return card_template("citation.md").template.strip()


def front_matter(kind: str, fields: Mapping[str, Any]) -> str:
    """Returns the header of a ``dataset`` or ``model`` card as YAML, made by the Hub's own library.

    ``fields`` are of ``DatasetCardData`` or ``ModelCardData``; ``eval_results`` become ``model-index``.
    """
    from huggingface_hub import DatasetCardData, ModelCardData

    data = (DatasetCardData if kind == "dataset" else ModelCardData)(**fields)
    return f"---\n{data.to_yaml().strip()}\n---"


def check_card(text: str, kind: str) -> None:
    """Checks a ``dataset`` or ``model`` card without the Hub, which checks it again when it is uploaded.

    Raises:
        DatasetError: its header is no YAML, lacks a licence, holds a malformed ``model-index`` or dataset's name, or a
            placeholder is left in the text.
    """
    from huggingface_hub import DatasetCard, ModelCard
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]
    from yaml import YAMLError

    try:
        card = (DatasetCard if kind == "dataset" else ModelCard)(text)
        if not getattr(card.data, "license", None):
            raise ValueError("its header names no license")
        for name in getattr(card.data, "datasets", None) or ():
            validate_repo_id(name)
        if left := re.search(r"\$[a-z_]+\b", card.text):
            raise ValueError(f"the placeholder {left.group()} was left")
    except (ValueError, YAMLError) as error:
        raise DatasetError(
            "The card is not valid.",
            got=str(error)[:400],
            allowed="a header that the Hub understands",
            hint="README.md",
        ) from error
