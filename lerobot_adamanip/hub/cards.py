"""Cards for the Hub: the templates of ``hub_cards/``, and what every card says."""

from __future__ import annotations

import importlib.resources
from importlib.resources.abc import Traversable
from pathlib import Path
from string import Template

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
