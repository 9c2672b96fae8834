"""Says what a policy did between a failed try and its repetition: `docs/memory.md`, "What follows a failed try".

    python scripts/show_repeats.py outputs/quick/train/checkpoints/last/pretrained_model --category safe

A repeated try counts as one of:

- `after a search`: in between, the hand let go and travelled to another place, where no part resisted it;
- `small`: the repeated motion was commanded by less than 1 cm and 0.1 rad;
- `at once`: any other.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.cli.progress import ProgressLines
from lerobot_adamanip.collection.trained_policy import TrainedPolicy
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import CLOSED_HAND, KeyFrameLabels
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.hardware.target_geometry import pose_error
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

SMALL_M, SMALL_RAD, ELSEWHERE_M = 0.01, 0.1, 0.05
AFTER_A_SEARCH, SMALL, AT_ONCE, ANOTHER = "after a search", "small", "at once", "another motion"


@dataclass(frozen=True)
class Step:
    """A key frame: poses of the hand before and after it and as commanded (4, 4), the commanded opening, labels."""

    before: NDArray[np.float64]
    commanded: NDArray[np.float64]
    opening: float
    reached: NDArray[np.float64]
    labels: KeyFrameLabels


def kind(failed: Step, between: list[Step], again: Step) -> str:
    """Returns what the try ``again`` is after the try ``failed``."""
    if (failed.labels.tried, failed.labels.direction) != (again.labels.tried, again.labels.direction):
        return ANOTHER
    start = failed.reached[:3, 3]
    distance = max((float(np.linalg.norm(step.reached[:3, 3] - start)) for step in between), default=0.0)
    if distance > ELSEWHERE_M and any(step.opening > CLOSED_HAND for step in between):
        return AFTER_A_SEARCH
    way, turn = pose_error(again.before, again.commanded)
    return SMALL if way < SMALL_M and turn < SMALL_RAD else AT_ONCE


def played(env: KeyframeEnv, policy: TrainedPolicy, seed: int) -> list[Step]:
    """Returns the key frames of an episode."""
    observation, _ = env.reset(seed=seed)
    policy.reset(seed)
    steps, has_ended = list[Step](), False
    while not has_ended:
        action, hand = policy.act(observation, env.task), env.feedback.tcp_in_base
        observation, _, terminated, truncated, _ = env.step(action)
        commanded, opening = pose_from_vector(action)
        steps.append(Step(hand, commanded, opening, env.feedback.tcp_in_base, env.labels))
        has_ended = terminated or truncated
    return steps


def main() -> int:
    """Prints the number of next tries of each kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--category", choices=tuple(CATEGORIES), default="safe")
    parser.add_argument("--scenes", type=int, default=60, help="number of validation scenes")
    parser.add_argument("--first-seed", type=int, default=610000)
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    options = parser.parse_args()

    with contextlib.redirect_stdout(sys.stderr):  # LeRobot prints
        policy = TrainedPolicy(options.checkpoint)
    env = KeyframeEnv(options.category, observe_images=False)
    kinds, show = Counter[str](), ProgressLines({"scenes": "scenes"})
    for number in range(options.scenes):
        steps = played(env, policy, options.first_seed + number)
        tries = [index for index, step in enumerate(steps) if step.labels.tried >= 0]
        for this, following in pairwise(tries):
            if steps[this].labels.failed:
                kinds[kind(steps[this], steps[this + 1 : following], steps[following])] += 1
        show("scenes", number + 1, options.scenes)
    env.close()
    counts = dict(kinds.most_common())
    text = json.dumps(counts) if options.json else ", ".join(f"{name}: {count}" for name, count in counts.items())
    sys.stdout.write(f"{text}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
