"""`adamanip objects`: lists the objects of a category, checks external assets, draws a contact sheet."""

from __future__ import annotations

import contextlib
import sys
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.cli.arguments import CategoryOrAll, print_result, require_effects, require_suffix
from lerobot_adamanip.cli.progress import show_progress
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.util.errors import ConfigurationError, SimulatorError

if TYPE_CHECKING:
    from lerobot_adamanip.assets import AssetReport, AssetSource
    from lerobot_adamanip.objects import ArticulatedObject

OPEN_FRACTION = 0.3
"""Opening of every second object on a sheet, as a fraction of the joint's range."""
_SIZES = (64, 1024)
SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
"""Endings of a picture's name."""
_GAP = 6
_PAPER, _INK, _PENCIL = (250, 250, 250), (25, 25, 28), (105, 105, 110)


@dataclass
class ObjectsCommand:
    """Lists the objects of a category and draws a contact sheet with one picture per object, every second one ajar.

    With --assets, it checks a folder of external assets: lists the usable ones and the problems of the others.
    """

    out: Path | None = None
    """Write a contact sheet (.png, .jpg or .webp)."""

    category: CategoryOrAll = "safe"
    """Category of the objects; all for every category."""

    assets: Path | None = None
    """Folder of external assets to check and list instead of generated objects."""

    objects: str = "seen"
    """seen, unseen, novel, FIRST:END (0:36), or ids separated by commas (safe_000,safe_n007); without --assets."""

    columns: int = 9
    """Number of pictures per row."""

    size: int = 240
    """Side length of a picture [px]."""

    json: bool = False
    """Print one JSON object instead of text."""

    def run(self) -> int:
        """Lists and draws. Returns 0."""
        if self.columns < 1 or not _SIZES[0] <= self.size <= _SIZES[1]:
            raise ConfigurationError(
                "A sheet of this size cannot be drawn.",
                got=f"--columns {self.columns} --size {self.size}",
                allowed=f"1 column or more, {_SIZES[0]} ... {_SIZES[1]} px",
                hint="--columns 9 --size 240",
            )
        if self.out is None:
            require_effects(self, {"with --out": ("columns", "size")})
        else:
            from lerobot_adamanip.cli.collect_setup import require_renderer

            require_suffix(self.out, SUFFIXES, "--out objects.png")
            require_renderer()
        chosen, unusable = self._chosen()
        if self.out is not None and chosen:
            compose_sheet(self._thumbnails(chosen), columns=self.columns, path=self.out)
        refused = [{"object_id": report.asset_id, "reason": report.problem} for report in unusable]
        values = {"category": self.category, "objects": [object_json(obj) for obj in chosen], "unusable": refused}
        print_result(self.json, {**values, "out": self.out}, "\n".join(self._lines(chosen, unusable)))
        return 0

    def _chosen(self) -> tuple[list[ArticulatedObject], list[AssetReport]]:
        """Returns the objects and the unusable external assets."""
        from lerobot_adamanip.catalog import make_object, parse_object_selection

        categories = tuple(CATEGORIES) if self.category == ALL else (self.category,)
        if self.assets is None:
            ids = [name for category in categories for name in parse_object_selection(category, self.objects)]
            return [make_object(name) for name in ids], []
        source = checked_source(self.assets)
        if self.category == ALL and self.assets.is_dir():
            categories = tuple(filter(source.holds, categories)) or categories  # of none: an error says what is missing
        reports = [report for category in categories for report in source.check(category)]
        usable = [source.load(report.asset_id, solid=False) for report in reports if report.usable]
        return usable, [report for report in reports if not report.usable]

    def _thumbnails(self, chosen: list[ArticulatedObject]) -> list[Thumbnail]:
        thumbnails: list[Thumbnail] = []
        with show_progress({"photograph": "photographed"}) as progress:
            progress("photograph", 0, len(chosen))
            from lerobot_env_adamanip.sim.thumbnails import render_thumbnail

            for number, obj in enumerate(chosen):
                image = render_thumbnail(obj, size=self.size, open_fraction=OPEN_FRACTION * (number % 2))
                thumbnails.append(Thumbnail(image, obj.object_id, obj.description))
                progress("photograph", len(thumbnails), len(chosen))
        return thumbnails

    def _lines(self, chosen: list[ArticulatedObject], unusable: list[AssetReport]) -> Iterator[str]:
        for obj in chosen:
            size = " x ".join(f"{100 * length:.0f}" for length in obj.size)
            yield f"{obj.object_id}  {size} cm  {obj.description}"
        for report in unusable:
            yield f"{report.asset_id}  cannot be used: {report.problem}"
        if self.assets is not None:
            yield f"{len(chosen)} usable, {len(unusable)} not"
        if self.out is not None and chosen:
            yield f"{len(chosen)} objects on {self.out}"


def checked_source(assets: Path) -> AssetSource:
    """Returns the assets of a folder. With the simulator, assets out of the arm's reach are unusable."""
    from lerobot_adamanip.assets import AssetSource
    from lerobot_env_adamanip.simulator import placement_check

    try:
        with contextlib.redirect_stdout(sys.stderr):  # simulator output must not get into the JSON
            return AssetSource(assets, placement_check())
    except SimulatorError:
        print("The simulator is missing, so the arm's reach is not checked.", file=sys.stderr)
        return AssetSource(assets)


def object_json(obj: ArticulatedObject) -> dict[str, Any]:
    """Returns an object as JSON-able data: id, split, size [m], description, parts and joints."""
    from lerobot_adamanip.catalog import object_split

    joints = [link.joint for link in obj.links if link.joint is not None]
    return {
        "object_id": obj.object_id,
        "split": object_split(obj.object_id),
        "size": [round(float(length), 4) for length in obj.size],
        "description": obj.description,
        "parts": [part.name for part in obj.parts],
        "joints": {joint.name: {"kind": joint.kind, "limits": list(map(float, joint.limits))} for joint in joints},
    }


class Thumbnail(NamedTuple):
    """A picture (S, S, 3), a name and a description."""

    image: NDArray[np.uint8]
    name: str
    description: str


def compose_sheet(thumbnails: Sequence[Thumbnail], *, columns: int, path: Path) -> None:
    """Writes the sheet: rows of ``columns`` pictures of one size with captions below. Creates missing folders."""
    from PIL import Image, ImageDraw, ImageFont

    side = thumbnails[0].image.shape[0]
    title, text = (ImageFont.load_default(size) for size in (max(9, side // 16), max(8, side // 20)))
    width = max(1, int(side / max(1.0, text.getlength("abcdefghij") / 10)))
    wrapped = [textwrap.wrap(thumbnail.description, width) for thumbnail in thumbnails]
    line = int(1.3 * text.size) if isinstance(text, ImageFont.FreeTypeFont) else 12
    caption = int(1.6 * side / 16) + line * max(map(len, wrapped)) + _GAP
    columns = min(columns, len(thumbnails))
    rows = -(-len(thumbnails) // columns)
    size = (columns * (side + _GAP) + _GAP, rows * (side + caption + _GAP) + _GAP)
    sheet = Image.new("RGB", size, _PAPER)
    draw: Any = ImageDraw.Draw(sheet)
    for index, (thumbnail, lines) in enumerate(zip(thumbnails, wrapped, strict=True)):
        x = _GAP + index % columns * (side + _GAP)
        y = _GAP + index // columns * (side + caption + _GAP)
        sheet.paste(Image.fromarray(thumbnail.image), (x, y))
        draw.text((x + 2, y + side + 3), thumbnail.name, _INK, title)
        for row, content in enumerate(lines):
            draw.text((x + 2, y + side + int(1.6 * side / 16) + row * line), content, _PENCIL, text)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
