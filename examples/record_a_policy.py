"""Record your own policy as a dataset: `python examples/record_a_policy.py outputs/mine --episodes 4`.

The policy here is a stand-in, the adaptive expert with noise on its actions. Any function from observations to actions
will do. The dataset has the format of `adamanip collect`: check it with `adamanip check`, train on it with
`lerobot-train`, select successes with `adamanip filter --where success=true`.
"""

from __future__ import annotations

import argparse

import numpy as np

from lerobot_adamanip.episode.rollout import next_goal
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.dataset_recorder import DatasetRecorder
from lerobot_env_adamanip.keyframe_env import KeyframeEnv


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", help="folder of the new dataset")
    parser.add_argument("--category", default="safe")
    parser.add_argument("--episodes", type=int, default=4)
    options = parser.parse_args()

    print("starting the simulator ...", flush=True)
    env = KeyframeEnv(options.category, objects="0:4", split="train", observe_images=False)
    recorder = DatasetRecorder(env, options.root, recorded_by="noisy expert")
    for seed in range(recorder.episodes, options.episodes):  # continues where an interrupted run has stopped
        recorder.reset(seed=seed)
        rng = np.random.default_rng(seed)
        expert = make_expert(options.category, "adaptive", env.annotations, generator=rng)
        goal, done, info = next(expert), False, {}
        while goal is not None and not done:
            action = goal.action()
            action[:3] += rng.normal(0.0, 0.001, 3)  # your policy's action (10,) goes here
            _, _, terminated, truncated, info = recorder.step(action)
            done = terminated or truncated
            goal = None if done else next_goal(expert, env.feedback)
        print(f"episode {seed}: {'success' if info['is_success'] else 'failed'}", flush=True)
    print("dataset:", recorder.save())
    recorder.close()


if __name__ == "__main__":
    main()
