"""Checks that the policy of a LeRobot command fits the environments: same categories, control and observations.

LeRobot compares only the names of images, and gives an environment's configuration no policy. So this reads the
command's option ``--policy.path``, as LeRobot's own commands do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lerobot.configs import parser
from lerobot.envs.configs import EnvConfig

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract.cameras import CAMERAS, image_column, is_image_column
from lerobot_adamanip.contract.categories import ALL, CATEGORIES
from lerobot_adamanip.contract.control import ACTION_NAMES, DENSE, EE_DELTA, JOINT, KEYFRAME, POSE, STATES
from lerobot_adamanip.contract.memory import MEMORY, TEXT
from lerobot_adamanip.contract.schema import ACTION, EFFORT, FPS, KEY_FRAME, POINT_CLOUD, STATE
from lerobot_adamanip.datasets.training_data import training_info, training_objects, training_options
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError, listed

if TYPE_CHECKING:
    from lerobot_env_adamanip.config import AdaManipEnvConfig


_OPTIONAL = {
    POINT_CLOUD: "--env.observe_cloud=true", EFFORT: "--env.observe_effort=true", MEMORY: "--env.memory=events",
}  # fmt: skip
"""Observation that environments may lack -> the option that adds it."""


def require_fitting_policy(environment: AdaManipEnvConfig, categories: Sequence[str]) -> None:
    """Raises `ConfigurationError` if the policy of ``--policy.path`` was trained on other categories or observations.

    A training with ``--dataset.repo_id`` may continue from a policy of any category, and ``other_categories`` test it.
    """
    path, policy = parser.get_path_arg("policy"), None
    if path is not None:
        is_free = environment.other_categories or parser.parse_arg("dataset.repo_id") is not None
        policy = require_fitting_checkpoint(path, environment, () if is_free else categories)
    _require_repeats(policy, environment)


def configuration_of(options: EnvironmentOptions) -> AdaManipEnvConfig:
    """Returns LeRobot's configuration of environments with these options."""
    from lerobot.envs.factory import make_env_config

    known = {item.name for item in fields(EnvConfig.get_choice_class(f"adamanip_{options.category}"))}
    values = {item.name: getattr(options, item.name) for item in fields(options) if item.name in known}
    corners = {"workspace_lower": options.workspace.lower, "workspace_upper": options.workspace.upper}
    configuration: AdaManipEnvConfig = make_env_config(f"adamanip_{options.category}", **values, **corners)
    return configuration


def require_fitting_checkpoint(path: str, environment: AdaManipEnvConfig, categories: Sequence[str]) -> Any:
    """Returns the configuration of a checkpoint that fits these environments, or raises `ConfigurationError`."""
    _require_categories(path, categories)
    return _require_shapes(path, environment)


def trained_categories(checkpoint: Path) -> tuple[str, ...]:
    """Returns the categories that a checkpoint was trained on; none if they are unknown.

    They are those of its dataset, or of the environment of its training if the dataset is not on this machine.
    """
    known = {category_of(name) for name in training_objects(checkpoint)}
    if not known:
        environment: Any = training_options(checkpoint).get("env")
        kind = str(environment.get("type")) if isinstance(environment, Mapping) else ""
        chosen = str(environment.get("categories", ALL)) if kind == "adamanip" else kind.removeprefix("adamanip_")
        known = set(CATEGORIES) if chosen == ALL else {name.strip() for name in chosen.split(",")}
    return tuple(name for name in CATEGORIES if name in known)


def _require_categories(path: str, categories: Sequence[str]) -> None:
    trained = trained_categories(Path(path))
    foreign = [name for name in categories if name not in trained]
    if trained and foreign:
        kind = "--env.type=adamanip"
        kind += f"_{trained[0]}" if len(trained) == 1 else f" --env.categories={','.join(trained)}"
        raise ConfigurationError(
            "The policy was trained on other categories.",
            got=f"environments of {listed(foreign)}",
            allowed=f"{listed(trained)}, on which {path} was trained",
            hint=f"{kind}; or, to test what it does there all the same, --env.other_categories=true",
        )


def _require_shapes(path: str, environment: AdaManipEnvConfig) -> Any:
    """Compares the inputs of a policy with the features of the environments, which have the same names in datasets."""
    from lerobot.configs import PreTrainedConfig
    from lerobot.envs.utils import env_to_policy_features

    policy = PreTrainedConfig.from_pretrained(path)
    _require_workspace(policy, path, environment)
    _require_control(policy, path, environment)
    _require_text(path, environment)
    offered = env_to_policy_features(environment)
    for name, feature in (policy.input_features or {}).items():
        if name == POINT_CLOUD and name in offered and hasattr(policy, "num_points"):
            continue  # uses the first points of a cloud, and checks their number itself
        if hasattr(policy, "max_state_dim") and (name == STATE or is_image_column(name)):
            continue  # SmolVLA and pi0 pad states and resize images, and keep the shapes of their first training
        trained, offer = tuple(feature.shape), offered.get(name)
        if offer is None and name in _OPTIONAL:
            raise ConfigurationError(
                f"The policy sees {name}, and the environments do not observe it.",
                got=f"observations {listed(sorted(offered))}",
                allowed=f"{name} {trained}, as {path} was trained",
                hint=_OPTIONAL[name],
            )
        if offer is not None and tuple(offer.shape) != trained:
            raise ConfigurationError(
                f"The policy was trained on {name} of another shape.",
                got=f"{tuple(offer.shape)} from the environments",
                allowed=f"{trained}, as {path} was trained",
                hint=_remedy(name, trained),
            )
    _require_cameras(policy, path, offered)
    return policy


def _require_control(policy: Any, path: str, environment: AdaManipEnvConfig) -> None:
    """Compares control, rate, and kinds of action and state with those of the training, as far as they are known."""
    control, fps = trained_control(policy, Path(path))
    inputs, outputs = policy.input_features or {}, policy.output_features or {}
    features = {"action": outputs.get(ACTION), "state": inputs.get(STATE)}
    sizes = {key: int(one.shape[0]) for key, one in features.items() if one is not None}
    kinds = {
        key: next((kind for kind, names in table.items() if len(names) == sizes.get(key)), None)
        for key, table in (("action", ACTION_NAMES), ("state", STATES))
    }
    if control is None and (kinds["action"] in (EE_DELTA, JOINT) or kinds["state"] == POSE):
        control = DENSE
    trained = {"control": control, **({"fps": fps, **kinds} if control == DENSE else {})}
    known = {name: value for name, value in trained.items() if value is not None}
    offered = (
        {name: getattr(environment.shared_options, name) for name in known} if environment.control == DENSE else {}
    )
    offered["control"] = environment.control
    if any(offered.get(name) != value for name, value in known.items()):
        raise ConfigurationError(
            "The policy was trained with another control.",
            got=", ".join(f"{name}={value}" for name, value in offered.items()),
            allowed=", ".join(f"{name}={value}" for name, value in known.items()) + f", as {path} was trained",
            hint=" ".join(f"--env.{name}={value}" for name, value in known.items()),
        )


def _require_text(path: str, environment: AdaManipEnvConfig) -> None:
    """Compares the memory in the instruction, which no feature shows, with that of the training, if it is known."""
    trained: Any = training_options(Path(path)).get("env")
    memory = trained.get("memory") if isinstance(trained, Mapping) else None
    if memory is not None and (memory == TEXT) != (environment.memory == TEXT):
        raise ConfigurationError(
            "The policy was trained with another memory.",
            got=f"memory={environment.memory}",
            allowed=f"memory={memory}, as {path} was trained",
            hint=f"--env.memory={memory}",
        )


def _require_repeats(policy: Any, environment: AdaManipEnvConfig) -> None:
    """Refuses a memory that is kept over episodes of different scenes."""
    given = str(parser.parse_arg("policy.memory_episodes") or getattr(policy, "memory_episodes", 1))
    kept = int(given) if given.isdecimal() and len(given) < 10 else 1  # the policy refuses what is no number
    if kept > 1 and environment.repeats % kept:
        raise ConfigurationError(
            "The policy keeps its memory over episodes that play different scenes.",
            got=f"memory_episodes={kept} with repeats={environment.repeats}",
            allowed="repeats that memory_episodes divides",
            hint=f"--env.repeats={kept} --eval.batch_size=1",
        )


def trained_control(policy: Any, checkpoint: Path) -> tuple[str | None, int | None]:
    """Returns the control and rate [Hz] that a checkpoint was trained with, each None if it is unknown.

    They are those that our policies store, else those of its dataset, or of the environment of its training.
    """
    if hasattr(policy, "control_fps"):
        return (KEYFRAME, None) if policy.control_fps is None else (DENSE, policy.control_fps)
    info = training_info(checkpoint)
    if info is not None:
        is_dense = KEY_FRAME in info["features"] or info["fps"] != FPS
        return (DENSE, int(info["fps"])) if is_dense else (KEYFRAME, None)
    environment: Any = training_options(checkpoint).get("env")
    if not isinstance(environment, Mapping) or environment.get("control") != DENSE:
        return None, None
    return DENSE, environment.get("fps") or EnvironmentOptions.fps


def _require_cameras(policy: Any, path: str, offered: Mapping[str, Any]) -> None:
    """Compares a policy's images with those offered, column -> feature; LeRobot's ``--rename_map`` renames them."""
    trained = {name: tuple(each.shape) for name, each in policy.input_features.items() if is_image_column(name)}
    seen = [name for name in offered if is_image_column(name)]
    missing = [name for name in trained if name not in seen]
    if not missing or parser.parse_arg("rename_map") is not None:
        return
    remedy = _remedy(missing[0], trained[missing[0]])
    if not seen:
        raise ConfigurationError(
            "The policy sees images, and the environments observe none.",
            got=f"observations {listed(sorted(offered))}",
            allowed=f"{missing[0]} {trained[missing[0]]}, as {path} was trained",
            hint=f"--env.observe_images=true {remedy}; where nothing renders: --env.image_source=raycast",
        )
    if hasattr(policy, "empty_cameras") and set(seen) <= trained.keys():
        return  # does without the others
    names = [name.removeprefix(image_column("")) for name in trained]
    cameras, renamed = ",".join(list(CAMERAS)[: len(names)]), ",".join(names)
    own = f"--env.cameras='[{renamed}]'"
    raise ConfigurationError(
        "The policy sees images of other cameras.",
        got=f"{listed(seen)} from the environments",
        allowed=f"{listed(list(trained))}, as {path} was trained",
        hint=own if set(names) <= CAMERAS.keys() else f"--env.cameras='[{cameras}]' --env.camera_names='[{renamed}]'",
    )


def _require_workspace(policy: Any, path: str, environment: AdaManipEnvConfig) -> None:
    if not hasattr(policy, "workspace_lower"):
        return
    trained = tuple(policy.workspace_lower), tuple(policy.workspace_upper)
    offered = environment.workspace_lower, environment.workspace_upper
    if trained != offered:
        options = zip(("lower", "upper"), map(list, trained), strict=True)
        raise ConfigurationError(
            "The policy was trained on clouds of another workspace.",
            got=f"environments that crop clouds to {offered[0]} to {offered[1]} m",
            allowed=f"{trained[0]} to {trained[1]} m, as {path} was trained",
            hint=" ".join(f"--env.workspace_{name}='{corner}'" for name, corner in options),
        )


def _remedy(name: str, shape: tuple[int, ...]) -> str:
    if is_image_column(name):
        return f"--env.image_size={shape[-1]}"
    if name == POINT_CLOUD:
        return f"--env.num_points={shape[0] // 3}"
    if name == STATE:
        return "a policy trained on key frames: adamanip keyframes RECORDING --out DIR"
    return "train on a dataset of these environments"
