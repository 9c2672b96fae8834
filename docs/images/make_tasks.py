"""Draws tasks.png: the nine tasks, each as the hand has just found out what opens it. Needs the simulator."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

SHOWN = {
    "bottle": ("bottle_005", 3), "pen": ("pen_002", 4), "pressure_cooker": ("pressure_cooker_001", 1),
    "coffee_maker": ("coffee_maker_011", 2), "safe": ("safe_003", 5), "microwave": ("microwave_004", 2),
    "window": ("window_003", 1), "door": ("door_001", 2), "lamp": ("lamp_010", 3),
}  # fmt: skip
"""Category -> object and seed."""
RENDERED, CROP, SIDE, BAR = 768, (60, 60, 708, 708), 300, 28


def last_view(category: str) -> Image.Image:
    """Returns the front image after the adaptive expert has succeeded."""
    name, seed = SHOWN[category]
    env = KeyframeEnv(category, objects=name, image_size=RENDERED, num_points=64, split="test")
    env.reset(seed=seed)
    expert = make_expert(category, "adaptive", env.annotations, generator=np.random.default_rng(seed))
    goal, ended, truncated = next(expert), False, False
    while not (ended or truncated):
        *_, ended, truncated, _ = env.step(goal.action())
        if not (ended or truncated):
            goal = expert.send(env.feedback)
    view = Image.fromarray(env.render())
    env.close()
    return view


def main(names: list[str]) -> None:
    """Writes the picture beside this file, of all categories or of those named (to look at)."""
    height = round(SIDE * (CROP[3] - CROP[1]) / (CROP[2] - CROP[0]))
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", 14)
    rows = -(-len(names) // 3)
    sheet = Image.new("RGB", (3 * SIDE, rows * (height + BAR)), "white")
    draw = ImageDraw.Draw(sheet)
    for place, name in enumerate(names):
        x, y = place % 3 * SIDE, place // 3 * (height + BAR)
        view = last_view(name).crop(CROP).resize((SIDE - 4, height - 2), Image.Resampling.LANCZOS)
        sheet.paste(view, (x, y))
        draw.text((x + 6, y + height + 4), CATEGORIES[name].instruction, fill=(30, 30, 30), font=font)
    sheet.save(Path(__file__).with_name("tasks.png"), optimize=True)


if __name__ == "__main__":
    main(sys.argv[1:] or list(CATEGORIES))
