"""Checks that the hidden state is not observable before a try.

For each category, the adaptive expert grasps an object on equal seeds under two hidden states (three for a lamp).
State, effort and all joints of arm and object must be bit-identical in every frame until the part is held. The cloud
and all images of the first and last frame must be bit-identical, too.

``--plain`` moves the open hand to the part by ManiSkill's own control instead, and compares until the first try.
``--dense`` moves it at control rate, 10 Hz, and compares the cloud and all images of every step.

For example: ``python scripts/check_hidden_state.py --category all --seeds 100 --workers 2``. ``--no-hold`` makes the
hidden state observable, so the check must fail. Returns 1 if a category fails.
"""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
from check_common import parser, print_reports, run_seeds
from numpy.typing import NDArray

from lerobot_adamanip.contract.cameras import CAMERAS
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.keyframes import Feedback, Phase
from lerobot_adamanip.contract.observation import state_vector
from lerobot_adamanip.contract.rotations import pose_vector
from lerobot_adamanip.episode.dense import KeyFrameMotion
from lerobot_adamanip.experts import make_expert
from lerobot_env_adamanip.sim.arm_driver import TICKS_PER_SECOND

FIRST_SEED = 300
TURNS = ({"direction": 1, "turn_range": 0.45}, {"direction": -1, "turn_range": 0.75})
VARIANTS: dict[str, tuple[dict[str, Any], ...]] = {
    **dict.fromkeys(CATEGORIES, TURNS),
    "safe": (
        {"locked": True, "direction": 1, "knob_range": 0.6},
        {"locked": False, "direction": -1, "knob_range": 1.0},
    ),
    "microwave": ({"locked": True}, {"locked": False}),
    "lamp": ({"mode": 0}, {"mode": 1}, {"mode": 2}),
}
"""Hidden states that differ as much as possible, by category."""
PLAIN_STEPS = 60
"""Control steps of ``--plain``."""
Frame = dict[str, NDArray[Any]]


def frames_until_held(
    task: Any, seed: int, hidden: dict[str, Any], *, look: bool = True, image: bool = True
) -> list[Frame]:
    """Lets the adaptive expert grasp the first part. Returns all data at reset and after each key frame.

    If ``look`` is set, the first and last frames have ``cloud`` (M, 3) [m, base frame] and the images (H, W, 3) of all
    cameras, drawn by ray casting and, with ``image``, by the renderer.
    """
    task.reset(seed=seed, options={"hidden_overrides": hidden, "reconfigure": True})
    expert = make_expert(task.category, "adaptive", task.placement.annotations, generator=np.random.default_rng(seed))
    frames, goal = [frame(task)], next(expert)
    if look:
        frames[0] |= seen(task, image=image)
    while goal.phase in (Phase.APPROACH, Phase.GRASP):
        felt = task.execute(goal.action())
        frames.append(frame(task))
        goal = expert.send(felt)
    if look:
        frames[-1] |= seen(task, image=image)
    return frames


def seen(task: Any, *, image: bool) -> Frame:
    """Returns the cloud and the images of all cameras, by ray casting and, with ``image``, by the renderer."""
    cameras = task.cameras
    pictures = {f"raycast {name}": cameras.raycast_image(name) for name in CAMERAS}
    pictures |= {f"render {name}": cameras.rendered_image(name) for name in CAMERAS} if image else {}
    return {"cloud": cameras.points(), **pictures}


class DenseTask:
    """What `KeyFrameMotion` needs to know of a task's arm."""

    options = SimpleNamespace(fps=10)

    def __init__(self, task: Any) -> None:
        self._driver, self.motion_limits = task.driver, task.definition.motion

    feedback = property(lambda self: self._driver.feedback)
    is_blocked = property(lambda self: self._driver.stalled)
    is_unreachable = property(lambda self: self._driver.unreachable)
    is_at_rest = property(lambda self: self._driver.is_at_rest)

    def action_toward(self, target: NDArray[np.float64], gripper: float) -> NDArray[np.float32]:
        """Returns the pose action (10,) to a pose (4, 4) and a gripper opening."""
        return pose_vector(target, gripper)


def frames_of_steps(task: Any, seed: int, hidden: dict[str, Any]) -> list[Frame]:
    """Lets the adaptive expert grasp the first part at control rate. Returns all data after each step."""
    task.reset(seed=seed, options={"hidden_overrides": hidden, "reconfigure": True})
    expert = make_expert(task.category, "adaptive", task.placement.annotations, generator=np.random.default_rng(seed))
    arm: Any = DenseTask(task)
    frames, goal, opening = [frame(task) | seen(task, image=False)], next(expert), 1.0
    while goal.phase in (Phase.APPROACH, Phase.GRASP):
        motion = KeyFrameMotion(arm, goal, moves_gripper=goal.gripper != opening, strained=False)
        outcome, opening = None, goal.gripper
        while outcome is None:
            task.driver.follow_target(motion.action())
            for _ in range(TICKS_PER_SECOND // arm.options.fps):
                task.driver.stream_tick()
            outcome = motion.outcome()
            frames.append(frame(task) | seen(task, image=False))
        goal = expert.send(Feedback(arm.feedback.tcp_in_base, arm.feedback.gripper, outcome))
    return frames


def frames_until_tried(task: Any, seed: int, hidden: dict[str, Any]) -> list[Frame]:
    """Moves the open hand to the first part by ``pd_ee_delta_pose``. Returns all data before the first try."""
    task.reset(seed=seed, options={"hidden_overrides": hidden, "reconfigure": True})
    goal, frames = next(iter(task.placement.annotations.values())).grasp[:3, 3], [frame(task)]
    for _ in range(PLAIN_STEPS):
        here = task.agent.tcp.pose.p[0].cpu().numpy()
        info = task.step(np.array([*np.clip(2 * (goal - here), -1, 1), 0, 0, 0, 1], np.float32))[-1]
        if task.simulation.tries.tries:
            break
        frames.append({**frame(task), "info": np.array(sorted(map(str, info.items())))})
    return frames


def frame(task: Any) -> Frame:
    """Returns all numbers of arm and object."""
    arm, robot, target = task.simulation.arm_state(), task.agent.robot._objs[0], task._objects.articulation._objs[0]
    return {
        "state": state_vector(task.driver.feedback, arm.qpos, arm.qvel),
        "effort": np.asarray(task.driver.effort, np.float32),
        "outcome": np.array(-1 if task.driver.feedback.outcome is None else int(task.driver.feedback.outcome)),
        "arm positions": np.array(robot.get_qpos()),
        "arm velocities": np.array(robot.get_qvel()),
        "object positions": np.array(target.get_qpos()),
        "object velocities": np.array(target.get_qvel()),
    }


def differences(first: list[Frame], second: list[Frame]) -> tuple[str, ...]:
    """Returns texts for all data that is not bit-identical."""
    texts = [] if len(first) == len(second) else [f"{len(first)} frames, {len(second)} frames"]
    for number, (one, other) in enumerate(zip(first, second, strict=False)):
        for name, numbers in one.items():
            if name not in other or numbers.shape != other[name].shape:
                texts.append(f"frame {number}: {name} of another shape")
            elif numbers.tobytes() != other[name].tobytes():
                far = np.abs(numbers.astype(np.float64) - other[name].astype(np.float64)).max()
                texts.append(f"frame {number}: {name} by up to {far:.2g}")
    return tuple(texts)


FRAMES_OF = {"keyframe": frames_until_held, "plain": frames_until_tried, "dense": frames_of_steps}
"""Control -> the frames of an episode up to its first try."""


def check(task: Any, seed: int, hold: bool, control: str) -> tuple[int, list[str]]:
    """Returns the seed and its differences between hidden states."""
    frames_of, task.holds_joints = FRAMES_OF[control], hold
    first, *others = (frames_of(task, seed, hidden) for hidden in VARIANTS[task.category])
    return seed, [text for other in others for text in differences(first, other)]


def main() -> int:
    """Parses, runs, prints. Returns 0 if no hidden state is observable."""
    line = parser(__doc__, seeds=100, first_seed=FIRST_SEED)
    line.add_argument("--no-hold", action="store_true", help="let joints move from reset on; the check must fail")
    line.add_argument("--plain", action="store_true", help="ManiSkill's control instead of key frames")
    line.add_argument("--dense", action="store_true", help="control rate instead of key frames")
    options = line.parse_args()
    hold, control = not options.no_hold, "plain" if options.plain else "dense" if options.dense else "keyframe"
    mode = {"control_mode": "pd_ee_delta_pose"} if options.plain else {}
    reports, lines = [], []
    for name, results in run_seeds(check, options, hold, control, **mode).items():
        differing = {seed: texts for seed, texts in results if texts}
        counts = {"seeds": len(results), "variants": len(VARIANTS[name]), "differing_seeds": len(differing)}
        passed = bool(results) and not differing
        reports.append(
            {"category": name, "hold": hold, "control": control, **counts, "differences": differing, "passed": passed}
        )
        lines.append(
            f"{name:16} {len(results):4} seeds under {len(VARIANTS[name])} hidden states: "
            f"{len(differing)} differ before anything is tried"
        )
        lines += [f"  seed {seed}: {'; '.join(texts[:4])}" for seed, texts in list(differing.items())[:5]]
    return print_reports(reports, lines, options)


if __name__ == "__main__":
    sys.exit(main())
