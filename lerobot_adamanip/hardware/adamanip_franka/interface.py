"""Kinds of action and state of a robot, from its options, or else from the policy of the command that creates it."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from lerobot.configs import parser

from lerobot_adamanip.contract.cameras import is_image_column
from lerobot_adamanip.contract.control import ACTION_NAMES, EE_DELTA, EE_POSE, FULL, POSE, STATES
from lerobot_adamanip.contract.schema import ACTION, EFFORT, POINT_CLOUD, STATE
from lerobot_adamanip.hardware.adamanip_franka.execution_check import Caller, rate_of_training
from lerobot_adamanip.hardware.arm import Execution
from lerobot_adamanip.hardware.dense_kinds import ARM_ACTIONS
from lerobot_adamanip.hardware.features import DEPTH_SUFFIX
from lerobot_adamanip.util.errors import ConfigurationError

DEFAULT_RATE = 30.0
"""Rate of LeRobot's robot commands [Hz]."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Interface:
    """Features that a robot offers to a recorder or a policy.

    Attributes:
        action, state: see `contract.control`.
        depth: whether observations hold depth images.
        images: name -> (C, H, W) of the policy's images; empty without a policy.
    """

    action: str
    state: str
    depth: bool
    images: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


def interface_of(config: Any) -> Interface:
    """Returns the interface of a robot with this configuration.

    A policy's shapes tell its kinds: 7, 8 or 10 numbers of an action, 8 or 24 of a state. Key frames have one kind.

    Raises:
        ConfigurationError: an option contradicts the policy or the execution mode, the arm lacks the policy's kind, or
            the policy needs the effort.
    """
    policy = Caller.of(config).policy
    inputs = dict(getattr(policy, "input_features", None) or {})
    if EFFORT in inputs:
        raise ConfigurationError(
            "The robot's observations hold no effort.",
            got=f"a policy with the input {EFFORT}",
            allowed="policies without it",
            hint="train again with --policy.use_effort=false, or on demonstrations without --effort",
        )
    sizes = {name: tuple(getattr(feature, "shape", ())) for name, feature in inputs.items()}
    images = {name: shape for name, shape in sizes.items() if is_image_column(name)}
    is_key_frames = config.execution == Execution.KEYFRAME
    needs_depth = is_key_frames or POINT_CLOUD in inputs or any(name.endswith(DEPTH_SUFFIX) for name in images)
    depth = needs_depth if config.depth is None else config.depth
    if is_key_frames:
        for name, kind in (("action", EE_POSE), ("state", FULL)):
            if getattr(config, name) not in (None, kind):
                raise _mismatch(name, getattr(config, name), kind, "execution=keyframe")
        return Interface(EE_POSE, FULL, depth, images)
    outputs = dict(getattr(policy, "output_features", None) or {})
    size = tuple(getattr(outputs.get(ACTION), "shape", ()))
    action = _kind("action", config.action, size, ACTION_NAMES, EE_DELTA)
    if action not in ARM_ACTIONS:
        raise ConfigurationError(
            "The arm executes no joint positions: its safety filter limits tool poses.",
            got=f"action={action}" if policy is None else f"a policy that predicts {action}",
            allowed=" or ".join(ARM_ACTIONS),
            hint="demonstrations with --action ee_delta",
        )
    return Interface(action, _kind("state", config.state, sizes.get(STATE, ()), STATES, POSE), depth, images)


def _kind(
    name: str, option: str | None, shape: tuple[int, ...], kinds: Mapping[str, Collection[str]], default: str
) -> str:
    """Returns the option, else the kind with the policy's number of values, else ``default``."""
    if len(shape) != 1:
        return option or default
    trained = next((kind for kind, names in kinds.items() if len(names) == shape[0]), None)
    if trained is None:
        raise ConfigurationError(
            f"The policy was trained on another {name}.",
            got=f"{shape[0]} numbers",
            allowed=", ".join(f"{len(names)} ({kind})" for kind, names in kinds.items()),
            hint="train on recordings or demonstrations of this version",
        )
    if option not in (None, trained):
        raise _mismatch(name, option, trained, f"a policy of {shape[0]} numbers")
    return trained


def _mismatch(name: str, got: str, needed: str, what: str) -> ConfigurationError:
    return ConfigurationError(
        f"The kind of {name} does not fit.",
        got=f"{name}={got} with {what}",
        allowed=f"{name}={needed}",
        hint=f"leave out --robot.{name}",
    )


def adopt_training_rate(config: Any) -> None:
    """Sets the rate of a rollout to that of the policy's training data, if it is known and no ``--fps`` is set."""
    caller = Caller.of(config)
    if caller.policy is None or config.execution == Execution.KEYFRAME:
        return
    rate, current = rate_of_training(caller.policy), getattr(caller.config, "fps", None)
    if rate is None or current is None or rate == current:
        return
    if parser.parse_arg("fps") is None:
        caller.config.fps = float(rate)
        if caller.config.dataset is not None and parser.parse_arg("dataset.fps") is None:
            caller.config.dataset.fps = int(rate)
        _log.info("The rollout runs at %g Hz, the rate of the policy's training data.", rate)
    else:
        _log.warning("The policy was trained at %g Hz, and the rollout runs at %g Hz: --fps=%g", rate, current, rate)


def command_rate(config: Any) -> float:
    """Returns the rate of the command's loop [Hz]: the option ``fps`` of a twin, or that of LeRobot's command."""
    caller = Caller.of(config)
    sources = (caller.dataset, caller.config, getattr(caller.config, "dataset", None))
    rates = [getattr(source, "fps", None) for source in (config, *sources)]
    return float(next((rate for rate in rates if rate), DEFAULT_RATE))
