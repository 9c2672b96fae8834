"""Who asks for environments: LeRobot's commands tell an environment's configuration nothing of themselves."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

TRAINING = ("lerobot.configs.train", "TrainPipelineConfig")
EVALUATION = ("lerobot.configs.eval", "EvalPipelineConfig")
"""Module and class of the configuration that whoever trains or evaluates with LeRobot holds."""


def held_by_callers(config: object, *kinds: tuple[str, str]) -> Iterator[Any]:
    """Yields the pipelines of ``kinds`` whose environment ``config`` is, held by the functions that called.

    Looks at callers however far up, so that it does not matter how LeRobot was started (command, ``accelerate``, a
    script).
    """
    classes = tuple(found for module, name in kinds if (found := getattr(sys.modules.get(module), name, None)))
    frame = sys._getframe(1) if classes else None
    while frame is not None:
        for value in list(frame.f_locals.values()):
            if isinstance(value, classes) and getattr(value, "env", None) is config:
                yield value
        frame = frame.f_back


def images_wanted(config: object) -> bool:
    """Returns whether the caller may look at images.

    All do but ``lerobot-eval`` and ``lerobot-train`` with a policy that takes none; a training makes its environments
    once its policy knows its inputs.
    """
    for pipeline in held_by_callers(config, EVALUATION, TRAINING):
        features = getattr(getattr(pipeline, "policy", None), "input_features", None)
        if features:
            return any(feature.type.name == "VISUAL" for feature in features.values())
    return True


def evaluation_seeds(config: object) -> tuple[int, int] | None:
    """Returns the half-open range of the seeds that LeRobot counts; None outside its commands or without a seed.

    LeRobot runs whole batches, gives the environments one seed after the other from the pipeline's ``seed``, and counts
    the first ``eval.n_episodes`` of them. (LeRobot 0.6.1, `lerobot.scripts.lerobot_eval.eval_policy`.)
    """
    for pipeline in held_by_callers(config, EVALUATION, TRAINING):
        if pipeline.seed is not None:
            return pipeline.seed, pipeline.seed + pipeline.eval.n_episodes
    return None
