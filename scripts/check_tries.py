"""Checks that no joint moves, is released or reveals its state without a labelled try, for any motion of the hand.

Random hands (open, half open or closed; at a part, near it or far away) move at random, under two hidden states (three
for a lamp). A joint without a try must be held and must not have moved. All numbers of arm and object must be
bit-identical under every hidden state until a joint is tried. Returns 1 if a category fails. For example:

    python scripts/check_tries.py --category all --seeds 400 --workers 2      # 2,000 hands per category
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import numpy as np
from check_common import parser, print_reports, run_seeds
from check_hidden_state import VARIANTS, Frame, differences, frame
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lerobot_adamanip.contract.keyframes import PRE_GRASP
from lerobot_adamanip.contract.rotations import pose_vector, transform
from lerobot_adamanip.episode.tries import MIN_JOINT_MOTION

FIRST_SEED = 800
HANDS = 5
"""Number of hands per scene."""
GRIPPERS = {0.0: "closed", 0.3: "half", 0.55: "half", 1.0: "open"}
"""Commanded openings, and their names."""
PLACES = {"at": (0.004, 0.05), "near": (0.03, 0.3), "far": (0.25, 1.0)}
"""Place of a hand -> standard deviations of its distance [m] and rotation [rad] from a grasp."""
WAY, TURN = 0.06, 0.6
"""Standard deviations of a hand's motion [m, rad]."""
MAX_GIVING_SHARE = 0.25
"""Largest allowed motion of a held joint, as a share of `MIN_JOINT_MOTION`. PhysX's limits yield up to 0.002 rad to
a hand that crushes a part, equally under every hidden state."""


@dataclass
class Result:
    """Result of one scene: hands, tries by kind of hand, motions after a try by spring or gravity, violations."""

    seed: int
    hands: int = 0
    tries: Counter[str] = field(default_factory=Counter)
    own_motions: int = 0
    wrong: list[str] = field(default_factory=list)


def random_hand(task: Any, rng: np.random.Generator) -> tuple[str, list[NDArray[np.float32]]]:
    """Returns the kind of a hand, and its three key frames: before a part, at it, and a random motion from there."""
    parts, place = list(task.placement.annotations.values()), str(rng.choice(list(PLACES)))
    part, (shift, turn) = parts[rng.integers(len(parts))], PLACES[place]
    grasp = part.moved(task.simulation.joint_positions()) @ _random(rng, shift, turn)
    first, second = rng.choice(list(GRIPPERS), 2)
    gripper = f"{GRIPPERS[first]} to {GRIPPERS[second]}"
    poses = (grasp @ transform((0.0, 0.0, -PRE_GRASP)), grasp, grasp @ _random(rng, WAY, TURN))
    openings = (1.0 if rng.random() < 0.5 else first, first, second)
    return f"{place}, {gripper}", [pose_vector(pose, opening) for pose, opening in zip(poses, openings, strict=True)]


def _random(rng: np.random.Generator, shift: float, turn: float) -> NDArray[np.float64]:
    return transform(rng.normal(size=3) * shift, Rotation.from_rotvec(rng.normal(size=3) * turn).as_matrix())


def play(task: Any, seed: int, hidden: dict[str, Any], result: Result) -> tuple[list[Frame], int]:
    """Runs the hands of a scene; returns all frames, and the number of those before the first try."""
    task.reset(seed=seed, options={"hidden_overrides": hidden, "reconfigure": True})
    simulation = task.simulation
    rng, frames, untried = np.random.default_rng(seed), [frame(task)], 1
    start, names, tracker = simulation.joint_positions(), simulation.mechanism.joints, simulation.tries
    for _ in range(HANDS):
        kind, actions = random_hand(task, rng)
        result.hands += 1
        for action in actions:
            ticks, before = [try_.ticks for try_ in tracker.tries], simulation.joint_positions()
            task.execute(action)
            frames.append(frame(task))
            positions = simulation.joint_positions()
            result.tries[kind] += len(tracker.tries) - len(ticks)
            pairs = zip_longest(tracker.tries, ticks, fillvalue=0)
            now = {names[try_.joint] for try_, earlier in pairs if try_.ticks > earlier}
            moved = {name for name in names if abs(positions[name] - before[name]) > MIN_JOINT_MOTION["revolute"]}
            result.own_motions += len(moved - now)
            for name in set(names) - {names[try_.joint] for try_ in tracker.tries}:
                if abs(positions[name] - start[name]) > MAX_GIVING_SHARE * MIN_JOINT_MOTION[tracker.kinds[name]]:
                    result.wrong.append(f"{name} moved by {positions[name] - start[name]:.3g} without a try; {kind}")
                if name not in simulation.held:
                    result.wrong.append(f"{name} was released without a try; {kind}")
        untried = untried if tracker.tries else len(frames)
    return frames, untried


def check(task: Any, seed: int) -> Result:
    """Returns the result of a scene under all hidden states."""
    result, variants = Result(seed), VARIANTS[task.category]
    first, *others = (play(task, seed, hidden, result) for hidden in variants)
    for frames, untried in others:
        same = min(untried, first[1])
        result.wrong += differences(first[0][:same], frames[:same])
    result.hands //= len(variants)
    return result


def main() -> int:
    """Parses, runs, prints. Returns 0 if the law holds."""
    options = parser(__doc__, seeds=400, first_seed=FIRST_SEED).parse_args()
    reports, lines = [], []
    for name, results in run_seeds(check, options).items():
        tries: Counter[str] = sum((result.tries for result in results), Counter())
        wrong = {result.seed: result.wrong for result in results if result.wrong}
        hands, own = sum(result.hands for result in results), sum(result.own_motions for result in results)
        counts = {"hands": hands, "tries": dict(sorted(tries.items())), "own_motions": own}
        reports.append({"category": name, **counts, "wrong": wrong, "passed": hands > 0 and not wrong})
        lines.append(
            f"{name:16} {hands:5} hands, {sum(tries.values()):5} tries, {own} motions by spring or gravity after one, "
            f"{len(wrong)} scenes break the law"
        )
        lines += [f"  seed {seed}: {'; '.join(texts[:3])}" for seed, texts in list(wrong.items())[:5]]
    return print_reports(reports, lines, options)


if __name__ == "__main__":
    sys.exit(main())
