"""Which external assets can be placed before the arm: by its kinematics alone, without a scene."""

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
"""Seed of a check's draws."""


@functools.cache
def placement_check(task: CategoryTask, poses: str) -> Callable[[ArticulatedObject], str]:
    """Returns a function that says why an object cannot be placed, an empty text if it can.

    One episode's draws are tried: an object placed there is placed in nearly every other.
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
    """Kinematics of an arm without shapes: no renderer is needed."""
    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    loader = scene.create_urdf_loader()
    loader.fix_root_link = True
    builder = loader.parse(AdaManipPanda.urdf_path)[0][0]
    for link in builder.link_builders:
        link.visual_records, link.collision_records = [], []
    return ArmKinematics(builder.build(), task.rest)
