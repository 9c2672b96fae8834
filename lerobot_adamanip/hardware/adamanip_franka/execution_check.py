"""Check that the actions of a LeRobot command fit the arm's execution mode, before the arm is connected.

A policy that was trained on key frames predicts complete motions. In ``stream`` mode each action would move the arm by
a few millimetres before the next one replaces it. A policy that was trained on ticks predicts the next 1/30 s. In
``keyframe`` mode the arm would come to rest after each action.

LeRobot gives a robot no policy, so the command's configuration is looked up on the call stack. Shapes of state and
action and columns of the training data tell both kinds apart: LeRobot stores statistics of all columns in a checkpoint,
also of stock policies.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, JOINT, POSE, STATES
from lerobot_adamanip.contract.schema import ACTION, KEY_FRAME, STATE
from lerobot_adamanip.hardware.arm import Execution
from lerobot_adamanip.hardware.features import ARM, INTERVENTION, KEY_FRAME_COLUMNS, recorded_kind
from lerobot_adamanip.util import json_fields
from lerobot_adamanip.util.errors import ConfigurationError

PREPROCESSOR = "policy_preprocessor.json"
"""File of a checkpoint that names the files with statistics."""
TRAINING = "train_config.json"
"""File of a checkpoint that names its training data."""
TICK_SHAPES = {
    ACTION: tuple((len(ACTION_NAMES[kind]),) for kind in (EE_DELTA, JOINT)),
    STATE: ((len(STATES[POSE]),),),
}
"""Shapes that key frames do not have."""
ONE_ACTION_IS = {Execution.KEYFRAME: "one complete motion (a key frame)", Execution.STREAM: "one tick of a stream"}


@dataclass(frozen=True)
class Caller:
    """The LeRobot command that creates or connects a robot.

    Attributes:
        config: its options; None outside LeRobot's commands.
        policy: configuration of its policy, if any.
        dataset: the dataset that it has opened, if any.
    """

    config: Any = None
    policy: Any = None
    dataset: Any = None

    @classmethod
    def of(cls, robot: object) -> Caller:
        """Returns the nearest command on the call stack whose ``cfg`` is for a robot with this configuration."""
        frame: FrameType | None = sys._getframe()
        while frame is not None and getattr(frame.f_locals.get("cfg"), "robot", None) is not robot:
            frame = frame.f_back
        if frame is None:
            return cls()
        config = frame.f_locals["cfg"]
        return cls(config, getattr(config, "policy", None), frame.f_locals.get("dataset"))


def check_caller(robot: Any, action: str) -> None:
    """Checks the LeRobot command that connects a robot with this configuration and kind of action.

    It checks the policy of `lerobot-rollout` and the dataset of `lerobot-replay`. Teleoperation may use either mode.

    Raises:
        ConfigurationError: the command's actions need the other execution mode, or it sends deltas more than once.
    """
    caller = Caller.of(robot)
    if action == EE_DELTA:
        _require_deltas_once(caller.config)
    if Execution(robot.execution) is Execution.KEYFRAME:
        _require_no_slide(caller.config)
    if caller.policy is not None:
        what, needed = f"policy {caller.policy.pretrained_path}", execution_of_policy(caller.policy)
    elif caller.dataset is not None and not hasattr(caller.config, "teleop"):
        what, needed = f"dataset {caller.config.dataset.repo_id}", execution_of_data(caller.dataset.features)
    else:
        return
    require_execution(needed, Execution(robot.execution), what)


def _require_deltas_once(config: Any) -> None:
    """Raises `ConfigurationError` if a rollout sends an action again: each time, a delta moves the arm farther."""
    got = []
    if getattr(getattr(config, "strategy", None), "type", None) == "dagger":
        got.append("--strategy.type=dagger, whose pause resends the last action at each tick")
    if (count := getattr(config, "interpolation_multiplier", 1)) > 1:
        got.append(f"--interpolation_multiplier={count}, which sends {count} actions for one of the policy")
    if got:
        raise ConfigurationError(
            "This rollout would move the arm again with each repeated ee_delta.",
            got=" and ".join(got),
            allowed="absolute actions: action=ee_pose, or execution=keyframe",
            hint="--robot.action=ee_pose with a policy trained on --action ee_pose demonstrations",
        )


def _require_no_slide(config: Any) -> None:
    """Raises `ConfigurationError` if the arm would slide to a person who takes over: each step is a key frame."""
    strategy: Any = getattr(config, "strategy", None)
    if getattr(config, "teleop", None) is not None and getattr(strategy, "smooth_handover", False):
        raise ConfigurationError(
            "A person who takes over would wait for 30 motions of the arm.",
            got=f"--strategy.type={strategy.type} with smooth_handover=true and execution={Execution.KEYFRAME}",
            allowed="smooth_handover=false: the teleoperators of this package begin where the hand is",
            hint="--strategy.smooth_handover=false",
        )


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
    features = {**(policy.input_features or {}), **(getattr(policy, "output_features", None) or {})}
    if any(tuple(getattr(features.get(name), "shape", ())) in sizes for name, sizes in TICK_SHAPES.items()):
        return Execution.STREAM
    columns = set(policy.input_features or ()) | _normalized_columns(path, revision)
    if KEY_FRAME_COLUMNS & columns and KEY_FRAME not in columns:
        return Execution.KEYFRAME
    return Execution.STREAM if ACTION in columns and INTERVENTION not in columns else None


def execution_of_data(features: Mapping[str, Any]) -> Execution | None:
    """Returns the execution mode of a dataset with these features; None if unknown, e.g. for a recorded rollout."""
    kinds = recorded_kind(features.get(ACTION), ACTION_NAMES), recorded_kind(features.get(STATE), STATES)
    if kinds[0] in (EE_DELTA, JOINT) or kinds[1] == POSE:
        return Execution.STREAM
    if KEY_FRAME in features:
        return None if ARM in features else Execution.STREAM
    return Execution.KEYFRAME if KEY_FRAME_COLUMNS & set(features) else None


def rate_of_training(policy: Any) -> float | None:
    """Returns the rate of a policy's training data [Hz]; None if they are not on this machine."""
    from lerobot.utils.constants import HF_LEROBOT_HOME

    try:
        dataset = json_fields.read(Path(policy.pretrained_path) / TRAINING)["dataset"]
        root = Path(dataset["root"] or HF_LEROBOT_HOME / dataset["repo_id"])
        return float(json_fields.read(root / "meta" / "info.json")["fps"])
    except (OSError, ValueError, LookupError, TypeError):
        return None


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
