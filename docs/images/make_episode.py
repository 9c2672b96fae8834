"""Draws episode.png: one adaptive episode on a locked safe. Run it from the repository's root; needs the simulator."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lerobot_adamanip.episode.rollout import rollout
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

SEED, OBJECT = 5, "safe_003"
HIDDEN = {"locked": True, "direction": -1}
CAPTIONS = {
    1: "reach for the handle",
    4: "pull: it does not move",
    10: "turn the knob: wrong way",
    13: "other way: it stops, unlocked",
    18: "back to the handle",
    21: "pull: it opens",
}
"""Key frame -> what it shows."""
RENDERED, CROP, SIDE, BAR = 768, (0, 34, 740, 630), 300, 30


def frames() -> list[Image.Image]:
    """Returns the front image after each key frame, the start first."""
    env = KeyframeEnv("safe", objects=OBJECT, image_size=RENDERED, hidden_overrides=HIDDEN, split="test")
    observation, _ = env.reset(seed=SEED)
    seen = [env.render()]
    expert = make_expert("safe", "adaptive", env.annotations, generator=np.random.default_rng(SEED))
    rollout(env, observation, expert, lambda _: seen.append(env.render()))
    env.close()
    return [Image.fromarray(image) for image in seen]


def main() -> None:
    """Writes the strip beside this file."""
    left, top, right, bottom = CROP
    height = round(SIDE * (bottom - top) / (right - left))
    font = ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", 15)
    strip = Image.new("RGB", (len(CAPTIONS) // 2 * SIDE, 2 * (height + BAR)), "white")
    draw = ImageDraw.Draw(strip)
    seen = frames()
    for place, (number, caption) in enumerate(CAPTIONS.items()):
        x, y = place % 3 * SIDE, place // 3 * (height + BAR)
        strip.paste(seen[number].crop(CROP).resize((SIDE - 4, height), Image.Resampling.LANCZOS), (x, y))
        draw.text((x + 6, y + height + 5), f"{number}  {caption}", fill=(30, 30, 30), font=font)
    strip.save(Path(__file__).with_name("episode.png"), optimize=True)


if __name__ == "__main__":
    main()
