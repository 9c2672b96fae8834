"""Hidden is hidden: two episodes that differ in the lock alone look the same until the door is pulled.

`python examples/hidden_state.py` drives the same key frames through both and says where the observations part.
"""

from __future__ import annotations

import argparse

import numpy as np

from lerobot_adamanip.episode.rollout import KeyFrame, rollout
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.keyframe_env import KeyframeEnv


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=5)
    seed = parser.parse_args().seed
    print("starting the simulator ...", flush=True)
    env = KeyframeEnv("safe", objects="0:4", observe_images=False)

    seen: list[KeyFrame] = []
    observation, _ = env.reset(seed=seed, options={"hidden_overrides": {"locked": True}})
    expert = make_expert("safe", "adaptive", env.annotations, generator=np.random.default_rng(0))
    rollout(env, observation, expert, seen.append)

    other, _ = env.reset(seed=seed, options={"hidden_overrides": {"locked": False}})
    for number, frame in enumerate(seen):
        same = all(np.array_equal(frame.observation[key], other[key]) for key in ("point_cloud", "agent_pos", "effort"))
        verdict = "the same to the bit" if same else "they differ"
        print(f"before key frame {number}, {frame.goal.phase.name}: {verdict}", flush=True)
        if not same:
            break
        other, _, _, _, _ = env.step(frame.goal.action())
    env.close()


if __name__ == "__main__":
    main()
