"""An expert at work, as a video: `python examples/watch_an_expert.py --category microwave --seed 3`.

The adaptive expert sees part poses and what the arm felt, never what is hidden; it tries, and changes its mind.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from lerobot.utils.io_utils import write_video

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.schema import FPS
from lerobot_adamanip.episode.rollout import KeyFrame, rollout
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.keyframe_env import KeyframeEnv


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--category", choices=CATEGORIES, default="safe")
    parser.add_argument("--seed", type=int, default=5, help="decides object, poses and hidden state")
    parser.add_argument("--video", default="outputs/expert.mp4")
    options = parser.parse_args()

    print("starting the simulator ...", flush=True)
    env = KeyframeEnv(options.category, observe_images=False)  # `render` draws with or without a Vulkan device
    observation, _ = env.reset(seed=options.seed)
    print("hidden:", env.hidden_state())
    frames = [env.render()]

    def watch(key_frame: KeyFrame) -> None:
        frames.append(env.render())
        labels = env.labels
        tried = f", tried joint {labels.tried}: {'failed' if labels.failed else 'it gave'}" if labels.tried >= 0 else ""
        outcome = key_frame.feedback.outcome.name
        print(f"{len(frames) - 1:2}  {key_frame.goal.phase.name:8} {outcome}{tried}", flush=True)

    expert = make_expert(options.category, "adaptive", env.annotations, generator=np.random.default_rng(options.seed))
    result = rollout(env, observation, expert, watch)
    env.close()
    Path(options.video).parent.mkdir(parents=True, exist_ok=True)
    write_video(options.video, frames, FPS)
    print(result.reason, "->", options.video)


if __name__ == "__main__":
    main()
