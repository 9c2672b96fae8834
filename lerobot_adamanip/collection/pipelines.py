"""Pipelines of a checkpoint, checked before LeRobot loads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lerobot_adamanip.util import json_fields

PIPELINES = ("policy_preprocessor.json", "policy_postprocessor.json")


def pipeline_steps(folder: Path) -> list[dict[str, Any]]:
    """Returns the steps of both pipelines of a checkpoint.

    Raises:
        ValueError: a file is damaged, or a step is not a registered one. LeRobot 0.6.1 imports and calls any function
            that a step names as ``class`` (https://github.com/huggingface/lerobot/issues/4219).
        OSError: a file is missing.
    """
    steps = [step for name in PIPELINES for step in json_fields.read(folder / name)["steps"]]
    for step in steps:
        if not isinstance(step.get("registry_name"), str):
            named = str(step.get("class"))[:80]
            raise ValueError(f"a step of a pipeline has no registry_name, but names the class {named!r} to be called")
    return steps
