"""Compares clouds made of a depth picture with the simulator's own, scene by scene.

Distances are to the nearest neighbour among all points, both ways: from the cloud of depth in whole millimetres to what
the simulator sees, and from the simulator's cloud to what the depth shows.

Returns 1 if half of the points are farther than 1 mm, or one in a hundred farther than 5 mm, or if making a cloud takes
more than 10 ms (median).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from check_common import Progress, count, header
from numpy.typing import NDArray

from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.contract.observation import workspace_cloud
from lerobot_adamanip.contract.schema import DEFAULT_NUM_POINTS
from lerobot_adamanip.hardware.camera_frames import CameraCalibration, simulated_calibration
from lerobot_adamanip.hardware.depth_cloud import depth_cloud, points_in_base
from lerobot_adamanip.util.errors import UnreachableError

FIRST_SEED = 500
MEDIAN, P99, CLOUD_MS = 1.0, 5.0, 10.0
"""[mm, mm, ms]"""
REPEATS = 5


class Comparison(NamedTuple):
    """Comparison of one scene's clouds.

    Attributes:
        seen: distance of each point of the cloud from depth to the simulator's [mm].
        kept: distance of each point of the simulator's cloud to those from depth [mm].
        milliseconds: time of one cloud from depth.
    """

    seen: NDArray[np.float64]
    kept: NDArray[np.float64]
    milliseconds: float


def compare(task: Any, num_points: int, calibration: CameraCalibration | None = None) -> Comparison:
    """Compares both clouds of a task's present scene."""
    from scipy.spatial import cKDTree

    views = task.views
    dense, depth = views.points(), cast_depth(task)
    known = calibration or simulated_calibration(camera_of(task))
    start = time.perf_counter()  # processor time would count another thread, which spins after the simulator's rays
    for _ in range(REPEATS):
        cloud = depth_cloud(depth, known, num_points, views.workspace)
    took = 1e3 * (time.perf_counter() - start) / REPEATS
    own = workspace_cloud(dense, views.workspace, num_points)
    seen, _ = cKDTree(dense).query(cloud)
    kept, _ = cKDTree(points_in_base(depth, known)).query(own)
    return Comparison(1e3 * seen, 1e3 * kept, took)


def camera_of(task: Any) -> dict[str, Any]:
    """The depth camera's parameters, as episodes tell them."""
    from lerobot_env_adamanip.sim.camera import camera_parameters, pinhole

    views = task.views
    return camera_parameters(pinhole(views.camera(views.depth_size, "front")))


def cast_depth(task: Any) -> NDArray[np.uint16]:
    """Returns the depth that rays see (H, W) [mm]; 0 where none met anything near the workspace."""
    from lerobot_env_adamanip.sim.ray_camera import RaycastSensor

    views = task.views
    pixels, points = RaycastSensor(views.camera(views.depth_size, "front"), views.bodies(), views.workspace).pixels()
    depth = np.zeros(views.depth_size**2, np.uint16)
    depth[pixels] = -points[:, 2]
    return depth.reshape(views.depth_size, views.depth_size)


def scenes(categories: tuple[str, ...], wanted: int) -> Iterator[Any]:
    """Yields tasks with placed scenes, as many of each category."""
    from lerobot_env_adamanip.simulator import make_task

    for index, category in enumerate(categories):
        share = wanted // len(categories) + (index < wanted % len(categories))
        task, seed = make_task(category), FIRST_SEED
        try:
            while share:
                seed += 1
                try:
                    task.reset(seed=seed, options={"reconfigure": True})
                except UnreachableError:
                    continue
                share -= 1
                yield task
        finally:
            task.close()


def summary(found: list[Comparison]) -> dict[str, Any]:
    """Numbers over all scenes, and whether they pass."""
    told: dict[str, Any] = {"scenes": len(found)}
    for name in ("seen", "kept"):
        distances = np.concatenate([getattr(each, name) for each in found])
        told[name] = {"median_mm": float(np.median(distances)), "p99_mm": float(np.percentile(distances, 99))}
    told["cloud_ms"] = float(np.median([each.milliseconds for each in found]))
    near = all(told[name]["median_mm"] <= MEDIAN and told[name]["p99_mm"] <= P99 for name in ("seen", "kept"))
    return {**told, "passed": near and told["cloud_ms"] <= CLOUD_MS}


def main() -> int:
    """Parses, runs, prints. Returns 0 if the clouds are the same."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--category", choices=(*CATEGORIES, "all"), default="all")
    parser.add_argument("--scenes", type=count, default=50)
    parser.add_argument("--num-points", type=count, default=DEFAULT_NUM_POINTS)
    options = parser.parse_args()
    warnings.filterwarnings("ignore")
    categories = tuple(CATEGORIES) if options.category == "all" else (options.category,)
    progress, found = Progress(options.scenes), []
    for task in scenes(categories, options.scenes):
        found.append(compare(task, options.num_points))
        progress.advance(1)
    told = summary(found)
    sys.stdout.write(json.dumps({**header(), **told}) + "\n")
    return 0 if told["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
