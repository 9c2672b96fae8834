"""Draw tasks.webp: the adaptive expert at work on all nine tasks. Needs the simulator and a Vulkan device."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import Goal
from lerobot_adamanip.episode.rollout import next_goal
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

SHOWN = {
    "bottle": ("bottle_005", 3), "pen": ("pen_002", 4), "pressure_cooker": ("pressure_cooker_001", 1),
    "coffee_maker": ("coffee_maker_011", 2), "safe": ("safe_003", 5), "microwave": ("microwave_004", 2),
    "window": ("window_003", 1), "door": ("door_001", 2), "lamp": ("lamp_010", 3),
}  # fmt: skip
"""Category -> object and seed."""
RENDERED, CROP, SIDE, BAR = 512, (40, 58, 472, 490), 264, 24
TICKS_A_FRAME, FRAMES, HOLD, FRAME_MS = 8, 88, 12, 100
"""Control ticks between two pictures; frames an episode is shown in, and how long its end is held."""


def episode(category: str) -> list[Image.Image]:
    """Returns `FRAMES` pictures of one episode of the adaptive expert, evenly spread over it."""
    name, seed = SHOWN[category]
    env = KeyframeEnv(category, objects=name, image_size=RENDERED, num_points=64, observe_images=False, split="test")
    env.reset(seed=seed)
    taken: list[Image.Image] = []
    expert = make_expert(category, "adaptive", env.annotations, generator=np.random.default_rng(seed))
    goal: Goal | None = next(expert)
    while goal is not None and env.episode.end is None:
        for _ in env.motion(goal.action()):
            if env.episode.task.simulation.ticks % TICKS_A_FRAME == 1:
                view = Image.fromarray(env.episode.task.cameras.image()).crop(CROP)
                taken.append(view.resize((SIDE, SIDE), Image.Resampling.LANCZOS))
        goal = next_goal(expert, env.feedback)
    assert env.episode.success, category
    env.close()
    return [taken[k] for k in np.linspace(0, len(taken) - 1, FRAMES - HOLD).round().astype(int)] + HOLD * taken[-1:]


def main(names: list[str]) -> None:
    """Writes the animation beside this file, of all categories or of those named (to look at)."""
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", 11)
    rows = -(-len(names) // 3)
    frames = [Image.new("RGB", (3 * SIDE, rows * (SIDE + BAR)), "white") for _ in range(FRAMES)]
    for place, name in enumerate(names):
        x, y = place % 3 * SIDE, place // 3 * (SIDE + BAR)
        for frame, view in zip(frames, episode(name), strict=True):
            frame.paste(view, (x, y))
            ImageDraw.Draw(frame).text(
                (x + 4, y + SIDE + 4), CATEGORIES[name].instruction, fill=(30, 30, 30), font=font
            )
    first, *rest = frames
    options: dict[str, Any] = {"quality": 62, "method": 6, "duration": FRAME_MS, "loop": 0}
    first.save(Path(__file__).with_name("tasks.webp"), save_all=True, append_images=rest, **options)


if __name__ == "__main__":
    main(sys.argv[1:] or list(CATEGORIES))
