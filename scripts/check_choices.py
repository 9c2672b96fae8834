"""What a policy would try next, before and after tries that failed, in scenes whose hidden state is flipped on purpose.

    python scripts/check_choices.py --category lamp --policy CHECKPOINT/pretrained_model --scenes 10

Each scene is played once under every hidden state (locked or not, either direction, each mode). Before each key frame
the policy draws its next action again and again; each draw is what it would try (a joint, and a way), or no try: an
approach, a grasp, a release. After k different tries have failed, whoever has a memory tries none of them again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from check_common import Progress, count, header
from numpy.typing import NDArray

from lerobot_adamanip.collection.trained_policy import TrainedPolicy
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.rotations import pose_from_vector
from lerobot_adamanip.contract.schema import GRIPPER_DIM
from lerobot_adamanip.episode.contact_labels import CLOSED, JointRange, KeyFrameMotion, find_try, joint_ranges
from lerobot_adamanip.evaluation.draws import NO_TRY
from lerobot_adamanip.evaluation.recovery import failed_since_motion
from lerobot_adamanip.util.files import write_atomically

FLIPPED: dict[str, tuple[Any, ...]] = {"locked": (False, True), "direction": (-1, 1), "mode": (0, 1, 2)}
"""Hidden values that a scene is played under; the others (ranges of joints) stay as drawn."""
FIRST_SEED = 0
Choice = tuple[str, int] | None
"""Joint and way of a try; None for no try."""


@dataclass
class Tally:
    """What was drawn, by how many different tries had failed and nothing has moved since.

    Attributes:
        draws: failed tries -> what was drawn -> how often.
        repeated: failed tries -> draws that repeat one of them.
        episodes: hidden state in words -> episodes, and those that were opened.
    """

    draws: dict[int, Counter[str]] = field(default_factory=dict)
    repeated: Counter[int] = field(default_factory=Counter)
    episodes: dict[str, list[int]] = field(default_factory=dict)

    def add(self, failed: Set[Choice], choices: list[Choice]) -> None:
        """Counts the draws of one key frame."""
        words = self.draws.setdefault(len(failed), Counter())
        words.update(NO_TRY if each is None else f"{each[0]} {'+' if each[1] > 0 else '-'}" for each in choices)
        self.repeated[len(failed)] += sum(each in failed for each in choices if each is not None)

    def to_json(self) -> dict[str, Any]:
        """Returns rows by failed tries: draws, share of those that repeat what failed, of tries and of all."""
        rows = []
        for number, words in sorted(self.draws.items()):
            tries, all_draws = words.total() - words[NO_TRY], words.total()
            rows.append(
                {
                    "failed": number,
                    "draws": dict(words.most_common()),
                    "repeat_of_tries": round(self.repeated[number] / max(1, tries), 4),
                    "repeat_of_all": round(self.repeated[number] / max(1, all_draws), 4),
                }
            )
        return {"after": rows, "episodes": self.episodes}


def choice(env: Any, action: NDArray[np.float32], was_closed: bool, ranges: Mapping[str, JointRange]) -> Choice:
    """Returns what an action (10,) would try from where the hand is; ``ranges`` as `joint_ranges` has them."""
    frame = KeyFrameMotion(env.feedback, was_closed, *pose_from_vector(action))
    found = find_try(frame, env.annotations, ranges, env.part_positions())
    return None if found is None else (found.joint, int(np.sign(found.sent)))


def flips(hidden: dict[str, Any], fixed: bool) -> Iterator[dict[str, Any]]:
    """Yields every hidden state of a scene: what was drawn, with the values of `FLIPPED` in all combinations."""
    names = [name for name in FLIPPED if name in hidden and not (fixed and name == "direction")]
    for values in itertools.product(*(FLIPPED[name] for name in names)):
        yield dict(zip(names, values, strict=True))


def play(env: Any, actor: TrainedPolicy, seed: int, overrides: dict[str, Any], *, samples: int, tally: Tally) -> None:
    """Plays one episode, and draws at each of its key frames."""
    observation, _ = env.reset(seed=seed, options={"hidden_overrides": overrides})
    actor.reset(seed)
    ranges = joint_ranges(env._running().obj)
    failed: frozenset[Choice] = frozenset()
    closed, success = False, False
    for _ in range(env.max_key_frames):
        draws = actor.draws(observation, env.task_description, samples)
        tally.add(failed, [choice(env, action, closed, ranges) for action in draws])
        action = actor.act(observation, env.task_description)
        observation, _, done, truncated, _ = env.step(action)
        closed = bool(action[GRIPPER_DIM] < CLOSED)
        labels = env.labels
        if labels.tried >= 0:
            tried = (env.joint_names[labels.tried], int(np.sign(labels.sent)))
            failed = failed_since_motion(failed, tried, bool(labels.failed))
        success = success or done
        if done or truncated:
            break
    told = tally.episodes.setdefault(", ".join(f"{name} {value}" for name, value in overrides.items()), [0, 0])
    told[0] += 1
    told[1] += success


def main() -> int:
    """Plays, counts, and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", choices=tuple(CATEGORIES), required=True)
    parser.add_argument("--policy", type=Path, required=True, help="folder pretrained_model of a checkpoint")
    parser.add_argument("--objects", default="seen", help="(%(default)s)")
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--scenes", type=count, default=10, help="each under every hidden state (%(default)s)")
    parser.add_argument("--samples", type=count, default=16, help="drawn at each key frame (%(default)s)")
    parser.add_argument("--out", type=Path, help="file to write the report to")
    parser.add_argument("--json", action="store_true", help="print the report")
    options = parser.parse_args()
    from lerobot_adamanip.mechanisms import fixed_direction
    from lerobot_env_adamanip.keyframe_env import KeyframeEnv

    actor, tally = TrainedPolicy(options.policy), Tally()
    env = KeyframeEnv(options.category, objects=options.objects, split=options.split, observe_images=False)
    fixed = fixed_direction(options.category, env.options.mechanism_preset) is not None
    progress = Progress(0, options.scenes)
    try:
        for seed in range(FIRST_SEED, FIRST_SEED + options.scenes):
            env.reset(seed=seed)
            for overrides in list(flips(env.hidden_state(), fixed)):
                play(env, actor, seed, overrides, samples=options.samples, tally=tally)
            progress.tell(1)
    finally:
        env.close()
    report = {**header(), "category": options.category, "split": options.split, **tally.to_json()}
    if options.out is not None:
        write_atomically(options.out, json.dumps(report, indent=1).encode())
    if options.json:
        sys.stdout.write(json.dumps(report) + "\n")
        return 0
    for row in report["after"]:
        share = f"{100 * row['repeat_of_tries']:.1f} % of tries repeat one of them"
        sys.stdout.write(f"{row['failed']} failed: {row['draws']}; {share}\n")
    for hidden, (episodes, opened) in report["episodes"].items():
        sys.stdout.write(f"{hidden or 'nothing hidden to flip'}: {opened}/{episodes}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
