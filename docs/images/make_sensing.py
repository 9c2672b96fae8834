"""Draw sensing.png: depth of the front camera at each level, and print its holes and its noise by distance."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from lerobot_adamanip.contract.sensing import BASELINE_M, FOCAL_PX, LEVELS
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.keyframe_env import KeyframeEnv
from lerobot_env_adamanip.sim.sensing import measured_depth

SHOWN = {"safe": ("safe_003", 5), "bottle": ("bottle_005", 3), "microwave": ("microwave_004", 2)}
"""Category -> object and seed."""
SIZE, BAR, NEAREST_M, FARTHEST_M = 320, 22, 0.6, 1.6
DISTANCES_M, WALL = (0.5, 0.85, 1.2), 128
"""Distances of a flat wall whose noise is printed, and side length of its picture [px]."""


def depth(category: str, level: str) -> NDArray[Any]:
    """Returns the depth (H, W) [m] with the hand at its first key frame; 0 where none is measured."""
    name, seed = SHOWN[category]
    options: dict[str, Any] = {"objects": name, "image_size": SIZE, "observe_images": False, "sensing": level}
    with contextlib.closing(KeyframeEnv(category, split="test", **options)) as env:
        env.reset(seed=seed)
        expert = make_expert(category, "adaptive", env.annotations, generator=np.random.default_rng(seed))
        env.step(next(expert).action())
        return np.asarray(env.episode.task.cameras.color_and_depth("raycast")[1] / 1e3)


def colored(image: NDArray[Any]) -> Image.Image:
    """Returns a picture of depth: near is bright, and where none is measured is black."""
    share = np.clip((FARTHEST_M - image) / (FARTHEST_M - NEAREST_M), 0, 1)
    rgb = (255 * colormaps["viridis"](share)[..., :3]).astype(np.uint8)
    return Image.fromarray(np.where(image[..., None] > 0, rgb, 0).astype(np.uint8))


def noise_mm(level: str, distance: float) -> float:
    """Returns the standard deviation of depth on a flat wall [mm], without the holes."""
    wall = np.full((WALL, WALL), distance, np.float32)
    rng = np.random.default_rng(0)
    measured = measured_depth(wall, np.zeros_like(wall), focal=FOCAL_PX, sensing=LEVELS[level], rng=rng)
    return 1e3 * float(measured[np.isfinite(measured)].std())


def main() -> None:
    """Writes the picture beside this file."""
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", 13)
    sheet = Image.new("RGB", (len(LEVELS) * SIZE, len(SHOWN) * (SIZE + BAR)), "white")
    for row, category in enumerate(SHOWN):
        seen: NDArray[Any] = np.zeros((SIZE, SIZE), np.bool_)
        for column, level in enumerate(LEVELS):
            image = depth(category, level)
            seen = image > 0 if column == 0 else seen
            holes = float((image[seen] == 0).mean())
            place = column * SIZE, row * (SIZE + BAR)
            sheet.paste(colored(image), place)
            text = f"{category}, {level}: {100 * holes:.0f} % holes"
            ImageDraw.Draw(sheet).text((place[0] + 4, place[1] + SIZE + 3), text, fill=(30, 30, 30), font=font)
            sys.stdout.write(text + "\n")
    for level in LEVELS:
        for distance in DISTANCES_M:
            published = 1e3 * distance**2 * LEVELS[level].disparity_noise_px / (FOCAL_PX * BASELINE_M)
            text = (
                f"{level}, wall at {distance} m: {noise_mm(level, distance):.2f} mm, by the formula {published:.2f}\n"
            )
            sys.stdout.write(text)
    sheet.quantize(128).save(Path(__file__).with_name("sensing.png"), optimize=True)


if __name__ == "__main__":
    main()
