"""Checks that nothing hidden shows before it is tried.

For each category the adaptive expert takes hold of an object, on equal seeds under two hidden states (three for a
lamp). State, effort and every joint of arm and object must be equal bit for bit in every frame up to and including the
one in which the part is held, and so must the cloud and the image of that frame.

For example: ``python scripts/check_hidden_state.py --category all --seeds 100 --workers 2``. ``--no-hold`` switches off
what hides the state, and the check has to fail. Returns 1 if a category does.
"""

from __future__ import annotations

import contextlib
import json
import sys
import warnings
from typing import Any

import numpy as np
from check_common import parser, run_seeds
from numpy.typing import NDArray

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import Phase
from lerobot_adamanip.contract.observation import state_vector
from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.util.errors import UnreachableError

FIRST_SEED = 300
TURNS = ({"direction": 1, "turn_range": 0.45}, {"direction": -1, "turn_range": 1.0})
VARIANTS: dict[str, tuple[dict[str, Any], ...]] = {
    **dict.fromkeys(CATEGORIES, TURNS),
    "safe": (
        {"locked": True, "direction": 1, "knob_range": 1.0},
        {"locked": False, "direction": -1, "knob_range": 1.4},
    ),
    "microwave": ({"locked": True}, {"locked": False}),
    "lamp": ({"mode": 0}, {"mode": 1}, {"mode": 2}),
}
"""Hidden states that are as far apart as they can be."""
Frame = dict[str, NDArray[Any]]


def frames_until_held(
    task: Any, seed: int, hidden: dict[str, Any], *, look: bool = True, image: bool = True
) -> list[Frame]:
    """Lets the adaptive expert take hold of the first part; all there is at reset and after each key frame.

    ``cloud`` (M, 3) [m, base frame] and, if one is wanted, ``image`` (H, W, 3) are in the last frame only, and only if
    somebody is to ``look``.
    """
    task.reset(seed=seed, options={"hidden_overrides": hidden, "reconfigure": True})
    expert = make_expert(task.category, "adaptive", task.placement.annotations, generator=np.random.default_rng(seed))
    frames, goal = [_frame(task)], next(expert)
    while goal.phase in (Phase.APPROACH, Phase.GRASP):
        felt = task.execute(goal.action())
        frames.append(_frame(task))
        goal = expert.send(felt)
    if look:
        seen = task.observe(image=image)
        frames[-1].update(cloud=seen.points_in_base, **({"image": seen.images["front"]} if image else {}))
    return frames


def _frame(task: Any) -> Frame:
    arm, robot, target = task.arm_state(), task.agent.robot._objs[0], task._objects.articulation._objs[0]
    return {
        "state": state_vector(task.feedback, arm.qpos, arm.qvel),
        "effort": np.asarray(task.effort, np.float32),
        "outcome": np.array(-1 if task.feedback.outcome is None else int(task.feedback.outcome)),
        "arm positions": np.array(robot.get_qpos()),
        "arm velocities": np.array(robot.get_qvel()),
        "object positions": np.array(target.get_qpos()),
        "object velocities": np.array(target.get_qvel()),
    }


def differences(first: list[Frame], second: list[Frame]) -> tuple[str, ...]:
    """Returns what is not equal bit for bit, in words."""
    found = [] if len(first) == len(second) else [f"{len(first)} frames, {len(second)} frames"]
    for number, (one, other) in enumerate(zip(first, second, strict=False)):
        for name, value in one.items():
            if name not in other or value.shape != other[name].shape:
                found.append(f"frame {number}: {name} of another shape")
            elif value.tobytes() != other[name].tobytes():
                far = np.abs(value.astype(np.float64) - other[name].astype(np.float64)).max()
                found.append(f"frame {number}: {name} by up to {far:.2g}")
    return tuple(found)


def check(category: str, seeds: list[int], hold: bool) -> list[tuple[int, tuple[str, ...]]]:
    """Returns each seed with its differences; seeds on which an object cannot be placed are left out."""
    from lerobot_env_adamanip.simulator import make_task

    warnings.filterwarnings("ignore")
    task, results = make_task(category), []
    task.holds_the_untried = hold
    first, *others = VARIANTS[category]
    try:
        for seed in seeds:
            with contextlib.suppress(UnreachableError):
                own = frames_until_held(task, seed, first)
                found = [each for hidden in others for each in differences(own, frames_until_held(task, seed, hidden))]
                results.append((seed, tuple(found)))
    finally:
        task.close()
    return results


def main() -> int:
    """Parses, runs, prints. Returns 0 if nothing shows."""
    made = parser(__doc__, seeds=100, first_seed=FIRST_SEED)
    made.add_argument("--no-hold", action="store_true", help="joints move from reset on; the check has to fail")
    options = made.parse_args()
    reports, lines = [], []
    for name, results in run_seeds(check, options, not options.no_hold).items():
        differing = {seed: list(found) for seed, found in results if found}
        counts = {"seeds": len(results), "variants": len(VARIANTS[name]), "differing_seeds": len(differing)}
        reports.append({"category": name, "hold": not options.no_hold, **counts, "differences": differing})
        reports[-1]["passed"] = bool(results) and not differing
        lines.append(
            f"{name:16} {len(results):4} seeds under {len(VARIANTS[name])} hidden states: "
            f"{len(differing)} differ before anything is tried"
        )
        lines += [f"  seed {seed}: {'; '.join(found[:4])}" for seed, found in list(differing.items())[:5]]
    sys.stdout.write((json.dumps(reports) if options.json else "\n".join(lines)) + "\n")
    return 0 if all(report["passed"] for report in reports) else 1


if __name__ == "__main__":
    sys.exit(main())
