"""Reachability check of external assets, from the arm's kinematics alone, without a scene."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import sapien

from lerobot_adamanip.objects import ArticulatedObject
from lerobot_adamanip.util.errors import UnreachableError
from lerobot_env_adamanip.sim.kinematics import ArmKinematics
from lerobot_env_adamanip.sim.placement import randomization
from lerobot_env_adamanip.sim.robot import AdaManipPanda
from lerobot_env_adamanip.sim.tasks.category_task import CategoryTask

SEED = 0
"""Seed of the sampled poses."""


@functools.cache
def placement_check(task: CategoryTask, poses: str) -> Callable[[ArticulatedObject], str]:
    """Returns a function that returns why an object cannot be placed, or an empty text.

    It samples one episode; an object that can be placed there can be placed in almost every episode.
    """
    spread = randomization(poses)

    def placement_problem(obj: ArticulatedObject) -> str:
        stand = task.stand(obj)
        try:
            stand.draw(np.random.default_rng(SEED), obj, _arm(task), spread)
        except UnreachableError:
            names = " or ".join(reach.part for reach in stand.reaches)
            return f"the arm does not reach its {names} on the way to it, held and turned, wherever it stands ({poses})"
        return ""

    return placement_problem


@functools.cache
def _arm(task: CategoryTask) -> ArmKinematics:
    """Returns the kinematics of an arm without shapes, which needs no renderer."""
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    builder = loader.parse(AdaManipPanda.urdf_path)[0][0]
    for link in builder.link_builders:
        link.visual_records, link.collision_records = [], []
    return ArmKinematics(builder.build(), task.rest)
