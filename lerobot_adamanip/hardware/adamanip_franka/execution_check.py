"""Check that the actions of a LeRobot command fit the arm's execution mode, before the arm is connected.

A policy that was trained on key frames predicts complete motions. In ``stream`` mode each action would move the arm by
a few millimetres before the next one replaces it. A policy that was trained on ticks predicts the next 1/30 s. In
``keyframe`` mode the arm would come to rest after each action.

LeRobot gives a robot no policy, so the command's configuration is looked up on the call stack. The columns of the
training data show which kind it is: LeRobot stores statistics of all of them in a checkpoint, also of stock policies.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from types import FrameType
from typing import Any

from lerobot_adamanip.contract.schema import ACTION, STATE
from lerobot_adamanip.hardware.arm import Execution
from lerobot_adamanip.hardware.features import INTERVENTION, KEY_FRAME_COLUMNS, SCALAR_NAMES, names_of
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError

PREPROCESSOR = "policy_preprocessor.json"
"""File of a checkpoint that names the files with statistics."""
ONE_ACTION_IS = {Execution.KEYFRAME: "one complete motion (a key frame)", Execution.STREAM: "one tick of a stream"}


def check_caller(robot: Any) -> None:
    """Checks the LeRobot command that connects a robot with this configuration.

    It checks the policy of `lerobot-rollout` and the dataset of `lerobot-replay`. Teleoperation may use either mode.

    Raises:
        ConfigurationError: the command's actions need the other execution mode.
    """
    frame = _caller(robot)
    if frame is None:
        return
    config = frame.f_locals["cfg"]
    if (policy := getattr(config, "policy", None)) is not None:
        what, needed = f"policy {policy.pretrained_path}", execution_of_policy(policy)
    elif not hasattr(config, "teleop") and (dataset := frame.f_locals.get("dataset")) is not None:
        what, needed = f"dataset {config.dataset.repo_id}", execution_of_data(dataset.features)
    else:
        return
    require_execution(needed, Execution(robot.execution), what)


def require_execution(needed: Execution | None, execution: Execution | None, what: str) -> None:
    """Raises `ConfigurationError` if both modes are known and differ."""
    if needed is None or execution is None or needed == execution:
        return
    raise ConfigurationError(
        f"The actions of {what} do not fit the arm's execution mode.",
        got=f"execution={execution}: one action is {ONE_ACTION_IS[execution]}",
        allowed=f"execution={needed}: one action of these data is {ONE_ACTION_IS[needed]}",
        hint=f"--robot.execution={needed}",
    )


def execution_of_policy(policy: Any) -> Execution | None:
    """Returns the execution mode of a policy's training data, from its configuration and its checkpoint.

    Data of other projects are ticks. Unknown (None): no statistics, or a recorded rollout, which may be of both modes.
    """
    path, revision = str(policy.pretrained_path), getattr(policy, "pretrained_revision", None)
    columns = set(policy.input_features or ()) | _normalized_columns(path, revision)
    if KEY_FRAME_COLUMNS & columns:
        return Execution.KEYFRAME
    return Execution.STREAM if ACTION in columns and INTERVENTION not in columns else None


def execution_of_data(features: Mapping[str, Any]) -> Execution | None:
    """Returns the execution mode of a dataset with these features; None if unknown, e.g. for a recorded rollout."""
    if KEY_FRAME_COLUMNS & set(features):
        return Execution.KEYFRAME
    return Execution.STREAM if set(SCALAR_NAMES) <= set(names_of(features.get(STATE))) else None


def _normalized_columns(checkpoint: str, revision: str | None) -> set[str]:
    """Returns the columns with statistics in a checkpoint's preprocessor; none if it cannot be read."""
    from safetensors import SafetensorError, safe_open

    columns: set[str] = set()
    try:
        steps = json_fields.read(_checkpoint_file(checkpoint, PREPROCESSOR, revision)).get("steps", [])
        for name in (Path(step["state_file"]).name for step in steps if "state_file" in step):
            with safe_open(_checkpoint_file(checkpoint, name, revision), "numpy") as tensors:
                columns |= {key.rpartition(".")[0] for key in tensors.keys()}  # noqa: SIM118 - not a mapping
    except (OSError, ValueError, TypeError, AttributeError, SafetensorError):
        return set()  # LeRobot reports a broken checkpoint when it loads it
    return columns


def _checkpoint_file(checkpoint: str, name: str, revision: str | None) -> Path:
    if (path := Path(checkpoint) / name).is_file():
        return path
    from huggingface_hub import hf_hub_download

    return Path(hf_hub_download(checkpoint, name, revision=revision))


def _caller(robot: object) -> FrameType | None:
    """Returns the nearest frame of the call stack whose ``cfg`` is for this robot; None outside LeRobot's commands."""
    frame: FrameType | None = sys._getframe()
    while frame is not None and getattr(frame.f_locals.get("cfg"), "robot", None) is not robot:
        frame = frame.f_back
    return frame
