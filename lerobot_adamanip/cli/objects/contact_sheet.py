"""Contact sheet: pictures of objects, each with its name and description below."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")
"""Endings of a picture's name."""
_GAP = 6
_PAPER, _INK, _PENCIL = (250, 250, 250), (25, 25, 28), (105, 105, 110)


class Thumbnail(NamedTuple):
    """A picture (S, S, 3), a name and a description."""

    image: NDArray[np.uint8]
    name: str
    description: str


def compose_sheet(portraits: Sequence[Thumbnail], *, columns: int, path: Path) -> None:
    """Writes the sheet: rows of ``columns`` pictures of one size with captions below. Creates missing folders."""
    side = portraits[0].image.shape[0]
    title, text = (ImageFont.load_default(size) for size in (max(9, side // 16), max(8, side // 20)))
    width = max(1, int(side / max(1.0, text.getlength("abcdefghij") / 10)))
    wrapped = [textwrap.wrap(portrait.description, width) for portrait in portraits]
    line = int(1.3 * text.size) if isinstance(text, ImageFont.FreeTypeFont) else 12
    caption = int(1.6 * side / 16) + line * max(map(len, wrapped)) + _GAP
    columns = min(columns, len(portraits))
    rows = -(-len(portraits) // columns)
    size = (columns * (side + _GAP) + _GAP, rows * (side + caption + _GAP) + _GAP)
    sheet = Image.new("RGB", size, _PAPER)
    draw: Any = ImageDraw.Draw(sheet)
    for index, (portrait, lines) in enumerate(zip(portraits, wrapped, strict=True)):
        x = _GAP + index % columns * (side + _GAP)
        y = _GAP + index // columns * (side + caption + _GAP)
        sheet.paste(Image.fromarray(portrait.image), (x, y))
        draw.text((x + 2, y + side + 3), portrait.name, _INK, title)
        for row, content in enumerate(lines):
            draw.text((x + 2, y + side + int(1.6 * side / 16) + row * line), content, _PENCIL, text)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
