"""Measures what self-calibration leaves of a camera's error: ``python scripts/check_self_calibration.py``."""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from lerobot_adamanip.experts import make_expert
from lerobot_adamanip.hardware.calibration.self_calibration import SelfCalibration, moved
from lerobot_env_adamanip.keyframe_env import KeyframeEnv

ERRORS_MM, KEY_FRAMES = (10, 20, 30), (1, 3, 5)
"""Rigid errors of the camera [mm], with 0.1 degrees per mm; numbers of key frames after which to measure."""


class TimedCalibration:
    """Replaces `SelfCalibration.update` by one that notes its CPU time in ``seconds``."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        update = SelfCalibration.update

        def timed(calibration: SelfCalibration, *view: object) -> bool:
            begun = time.process_time()
            is_seen = update(calibration, *view)  # type: ignore[arg-type]
            self.seconds.append(time.process_time() - begun)
            return is_seen

        SelfCalibration.update = timed  # type: ignore[method-assign]


def residuals(env: KeyframeEnv, seed: int) -> dict[int, float]:
    """Returns number of key frames -> mean error of the workspace's points after correction [mm], for one scene."""
    env.reset(seed=seed)
    cameras, box = env.episode.task.cameras, env.workspace
    assert cameras.calibration is not None
    assert cameras.errors is not None
    points = np.random.default_rng(0).uniform(box.lower, box.upper, (200, 3))
    expert = make_expert(env.category, "adaptive", env.annotations, generator=np.random.default_rng(0))
    goal, left = next(expert), {}
    for frames in range(1, max(KEY_FRAMES) + 1):
        if frames in KEY_FRAMES:
            motion = cameras.calibration.correction @ cameras.errors.camera
            left[frames] = 1e3 * float(np.linalg.norm(moved(points, motion) - points, axis=1).mean())
        if env.step(goal.action())[2]:
            break
        goal = expert.send(env.feedback)
    return left


def main() -> int:
    """Prints a row per error: median and 90 % over scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", default="safe")
    parser.add_argument("--sensing", default="d435", help="other errors of the sensors")
    parser.add_argument("--seeds", type=int, default=12, help="number of scenes")
    options = parser.parse_args()
    timed = TimedCalibration()
    for error in ERRORS_MM:
        sensing = f"{options.sensing},camera_error_mm={error},camera_error_deg={error / 10}"
        env = KeyframeEnv(options.category, observe_images=False, sensing=sensing, self_calibration=True)
        scenes = [residuals(env, seed) for seed in range(options.seeds)]
        env.close()
        cells = [f"{error} mm, {error / 10:g} deg"]
        for frames in KEY_FRAMES:
            left = [scene[frames] for scene in scenes if frames in scene]
            cells.append(f"{np.median(left):.1f} ({np.quantile(left, 0.9):.1f})")
        sys.stdout.write(f"| {' | '.join(cells)} |\n")
        sys.stdout.flush()
    milliseconds = 1e3 * np.asarray(timed.seconds)
    sys.stdout.write(
        f"{np.median(milliseconds):.0f} ms an update in the median, {np.quantile(milliseconds, 0.9):.0f} ms at 90 %\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
