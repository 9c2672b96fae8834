"""`adamanip objects`: draw a contact sheet of the objects of a category."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.catalog import SEEN_COUNTS, make_object, parse_object_id, parse_object_selection
from lerobot_adamanip.categories import ALL, CATEGORIES
from lerobot_adamanip.cli.objects.contact_sheet import Thumbnail, compose_sheet, sheet_suffix
from lerobot_adamanip.errors import ConfigurationError
from lerobot_adamanip.objects import ArticulatedObject

OPEN_FRACTION = 0.3
"""How far every second object stands open on a sheet."""
_SIZES = (64, 1024)


@dataclass
class Objects:
    """Lists the objects of a category, and draws a contact sheet: each photographed alone, every second one ajar."""

    sheet: Path | None = None
    """Picture to write (.png, .jpg or .webp)."""

    category: str = "safe"
    """Which kind of object; all for every one."""

    objects: str = "seen"
    """seen, unseen, FIRST:END (0:36), or ids separated by commas (safe_000,safe_007)."""

    columns: int = 9
    """Portraits beside each other."""

    size: int = 240
    """Side of a portrait [px]."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Lists and draws; 0."""
        wanted = CATEGORIES if self.category == ALL else (self.category,)
        chosen = [make_object(name) for each in wanted for name in parse_object_selection(each, self.objects)]
        if self.columns < 1 or not _SIZES[0] <= self.size <= _SIZES[1]:
            raise ConfigurationError(
                "A sheet cannot be drawn like that.",
                got=f"--columns {self.columns} --size {self.size}",
                allowed=f"1 column or more, {_SIZES[0]} ... {_SIZES[1]} px",
                hint="--columns 9 --size 240",
            )
        if self.sheet is not None:
            sheet_suffix(self.sheet)
            with contextlib.redirect_stdout(sys.stderr):  # what the simulator prints must not get into the JSON
                portraits = self._portraits(chosen)
            compose_sheet(portraits, columns=self.columns, path=self.sheet)
        self._print(chosen)
        return 0

    def _portraits(self, chosen: list[ArticulatedObject]) -> list[Thumbnail]:
        from rich.console import Console
        from rich.progress import track

        from lerobot_env_adamanip.sim.thumbnails import render_thumbnail

        numbered = track(list(enumerate(chosen)), "photographing", console=Console(stderr=True), disable=self.json)
        made = []
        for number, obj in numbered:
            image = render_thumbnail(obj, size=self.size, open_fraction=OPEN_FRACTION * (number % 2))
            made.append(Thumbnail(image, obj.object_id, obj.description))
        return made

    def _print(self, chosen: list[ArticulatedObject]) -> None:
        if self.json:
            sheet = None if self.sheet is None else str(self.sheet)
            print(json.dumps({"category": self.category, "objects": list(map(to_json, chosen)), "sheet": sheet}))
            return
        for obj in chosen:
            size = " x ".join(f"{100 * length:.0f}" for length in obj.size)
            print(f"{obj.object_id}  {size} cm  {obj.description}")
        if self.sheet is not None:
            print(f"{len(chosen)} objects on {self.sheet}")


def to_json(obj: ArticulatedObject) -> dict[str, Any]:
    """The machine's version of an object: id, seen, size [m], description, parts and joints."""
    category, number = parse_object_id(obj.object_id)
    joints = [link.joint for link in obj.links if link.joint is not None]
    return {
        "object_id": obj.object_id,
        "seen": number < SEEN_COUNTS[category],
        "size": [round(float(length), 4) for length in obj.size],
        "description": obj.description,
        "parts": [part.name for part in obj.parts],
        "joints": {joint.name: {"kind": joint.kind, "limits": list(map(float, joint.limits))} for joint in joints},
    }
