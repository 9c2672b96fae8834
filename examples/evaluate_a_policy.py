"""A trained policy in a loop of one's own: `python examples/evaluate_a_policy.py CHECKPOINT_FOLDER/pretrained_model`.

`lerobot-eval` does this with videos, in several processes; here are its parts, for who wants to do something else.
"""

from __future__ import annotations

import argparse

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

import lerobot_env_adamanip  # noqa: F401  (registers dp3_adaptive)
from lerobot_adamanip.contract import schema
from lerobot_adamanip.evaluation.rates import wilson_interval
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

COLUMNS = {schema.POINT_CLOUD: "point_cloud", schema.STATE: "agent_pos", schema.EFFORT: "effort"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint")
    parser.add_argument("--category", default="safe")
    parser.add_argument("--split", choices=("validation", "test"), default="validation", help="test: reported numbers")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--key-frames", type=int, default=schema.MAX_KEY_FRAMES)
    options = parser.parse_args()

    config = PreTrainedConfig.from_pretrained(options.checkpoint)
    policy = get_policy_class(config.type).from_pretrained(options.checkpoint)
    before, after = make_pre_post_processors(config, pretrained_path=options.checkpoint)
    print("starting the simulator ...", flush=True)
    env = KeyframeEnv(options.category, split=options.split, observe_images=False, max_key_frames=options.key_frames)

    successes = 0
    for seed in range(1000, 1000 + options.episodes):
        observation, _ = env.reset(seed=seed)
        policy.reset()  # forgets the actions of the episode before
        done = False
        while not done:
            batch = {column: torch.from_numpy(observation[key])[None] for column, key in COLUMNS.items()}
            action = after(policy.select_action(before(batch)))[0].numpy()
            observation, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        successes += info["is_success"]
        print(f"seed {seed}: {'success' if info['is_success'] else 'failed'}, hidden {env.hidden_state()}", flush=True)
    env.close()
    low, high = wilson_interval(successes, options.episodes)
    print(f"{options.split} scenes: {successes}/{options.episodes}, 95 % interval {low:.2f} ... {high:.2f}")


if __name__ == "__main__":
    main()
