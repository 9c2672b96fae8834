"""Model card of a policy, from its checkpoint and results."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import safe_open

from lerobot_adamanip.contract.control import DENSE
from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.datasets.cards import COLUMNS, LICENSE, card_template, front_matter, shared_fields
from lerobot_adamanip.evaluation.results import ResultFile, command_options
from lerobot_adamanip.hub.model_index import eval_results, results_table
from lerobot_adamanip.util.json_fields import either, flag, integer, listing, mapping, number, optional, some, text

_HIDDEN = "articulated objects whose mechanism cannot be seen"
_SUMMARIES = {
    "dp3_adaptive": f"A policy over 3D point clouds for {_HIDDEN} ([AdaManip](https://adamanip.github.io), ICLR 2025).",
    "vat_mart": f"VAT-Mart's point-level policy for {_HIDDEN}.",
    "adaafford": f"AdaAfford's point-level policy for {_HIDDEN}.",
    "sampling": "Random macro actions: the baseline that knows where a part is held, and nothing else.",
}
_KEY_FRAME = "One action is one key frame: the arm is driven to the pose, or until it is stopped."
_CONTACTS = "Past motions of its closed hand, and how far the arm followed them, tell it what has been tried."
_METHODS = {
    "keyframe": "A diffusion policy: it chooses an anchor among the motions of its demonstrations, denoises around it, "
    "and refines the pose.",
    "dense": "The method is the paper's, in the tool's frame: a diffusion policy, in chunks of actions.",
    "dp3": "The method is 3D Diffusion Policy, without a history of actions.",
    "paper": "The method is the paper's: a diffusion policy, conditioned on observations and its past actions.",
}
"""Preset of dp3_adaptive -> its method, for a card."""
_ROWS = {
    "preset": ("preset", "`{}`"),
    "num_points": ("points", "the first {} of a cloud, which is farthest-point ordered"),
    "n_obs_steps": ("observations", "{}"),
    "n_action_history_steps": ("history", "the last {} actions"),
    "horizon": ("generates", "{} actions"),
    "chunk_size": ("generates", "{} actions"),
    "n_action_steps": ("executes", "{} before it looks again"),
    "encoder": ("encoder", "{}"),
    "vision_backbone": ("encoder", "{}"),
    "num_anchors": ("chooses among", "{} motions"),
    "num_refinements": ("refines poses", "{} times"),
    "noise_scheduler_type": ("sampler", "{}"),
    "num_inference_steps": ("sampling steps", "{}"),
}
"""Policy option -> its name and format on a card."""
_OF_DENSE = ("control", "fps", "action", "state", "observe_cloud", "observe_effort")
_OF_ALL = {
    "memory": "none", "image_size": "256", "num_points": "1024", "sensing": "exact", "self_calibration": "false",
    "poses": "randomized", "mechanism_rules": "paper", "hints": "0.0", "max_failed_tries": "", "episode_length": "",
}  # fmt: skip
"""Options of environments that decide observations or scenes: at control rate, and at both with their defaults."""
_TRAINING = ("steps", "batch_size", "seed", "num_workers")

_NAME = text(r"[A-Za-z0-9_][\w./-]{0,199}", "a name of letters, digits, _ . / -")
_VALUE = optional(either(flag, number(-1e15, 1e15), text(r"[^\r\n`<>|]{0,200}", "plain text of one line")))
_FEATURES = optional(mapping(_NAME, some({"type": _NAME, "shape": listing(integer(0, 10**9), 0, 10)}), 1000))
CARD_FIELDS = {
    "config.json": some(
        {
            "type": _NAME,
            "license": _VALUE,
            "tags": optional(listing(text(r"[^\r\n]{1,100}", "a tag"), 0, 100)),
            "input_features": _FEATURES,
            "output_features": _FEATURES,
            **dict.fromkeys((*_ROWS, "control_fps"), _VALUE),
        }
    ),
    "train_config.json": some(
        {
            "env": optional(some({"type": optional(_NAME), **dict.fromkeys((*_OF_DENSE, *_OF_ALL), _VALUE)})),
            "dataset": optional(some({})),
            **dict.fromkeys(_TRAINING, _VALUE),
        }
    ),
}
"""File of a checkpoint -> check of what its card shows, which is Markdown and must not be markup of a file's own."""


@dataclass(frozen=True)
class Checkpoint:
    """Checkpoint data for a policy's card.

    Attributes:
        config: content of ``config.json``.
        training: content of ``train_config.json``; empty if unknown.
        parameters: number of parameters of the acting network.
        updates: number of updates in averaged weights; None without averaging.
    """

    config: Mapping[str, Any]
    training: Mapping[str, Any]
    parameters: int
    updates: int | None = None

    @classmethod
    def read(cls, folder: Path) -> Checkpoint:
        """Reads a checked folder ``pretrained_model``."""
        config, training = (json.loads((folder / name).read_text()) for name in ("config.json", "train_config.json"))
        with safe_open(folder / "model.safetensors", framework="np") as tensors:
            shapes = {name: tensors.get_slice(name).get_shape() for name in tensors.keys()}  # noqa: SIM118
            updates = int(tensors.get_tensor("ema_steps")) if "ema_steps" in shapes else None
        acting = (math.prod(shape) for name, shape in shapes.items() if not name.startswith("ema_"))
        return cls(config, training, sum(acting), updates)


def model_card(
    checkpoint: Checkpoint, repo_id: str, *, results: Sequence[ResultFile] = (), dataset: str | None = None
) -> str:
    """Returns the README of a policy.

    Args:
        checkpoint: checkpoint data of the policy.
        repo_id: repository name on the Hub.
        results: evaluation results; they also become the card's `model-index`.
        dataset: Hub name of the training dataset. Default: from the training configuration.
    """
    config, training = checkpoint.config, checkpoint.training
    kind, demos = str(config["type"]), dataset or _dataset_of(training)
    env_type, env_options = _environment(training.get("env") or {}, results)
    fields: dict[str, Any] = {
        "license": config.get("license") or LICENSE,
        "library_name": "lerobot",
        "pipeline_tag": "robotics",
        "tags": sorted({"robotics", "lerobot", "lerobot_env_adamanip", "adamanip", kind, *(config.get("tags") or ())}),
        "model_name": repo_id.rpartition("/")[2],
    }
    if demos is not None:
        fields["datasets"] = [demos]
    if results:
        fields["eval_results"] = eval_results(results)
    return card_template("model_card.md").substitute(
        front_matter=front_matter("model", fields),
        title=kind,
        summary=_SUMMARIES.get(kind, f"LeRobot's `{kind}`, trained on demonstrations at articulated objects."),
        repo_id=repo_id,
        **shared_fields(),
        env_type=env_type,
        env_options="".join(f" --env.{name}={value}" for name, value in env_options.items()),
        facts=_facts(checkpoint),
        notes=_notes(config, env_options),
        results=results_table(results),
        training=_training(training, demos),
        command=train_command(training, repo_id, kind, demos),
    )


def _environment(trained: Mapping[str, Any], results: Sequence[ResultFile]) -> tuple[str, dict[str, str]]:
    """Returns the type and the options of the environments to evaluate in: those of the results, or of the training."""
    options = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in trained.items()
        if value is not None and (name, value) != ("episode_length", MAX_KEY_FRAMES)
    }
    kind = str(trained.get("type") or "adamanip")
    if results:
        options = {name.removeprefix("--env."): value for name, value in command_options(results[0].command).items()}
        categories = {row.category for result in results for row in result.rows}
        kind = f"adamanip_{categories.pop()}" if len(categories) == 1 else kind
    names = (*(_OF_DENSE if options.get("control") == DENSE else ()), *_OF_ALL)
    return kind, {name: options[name] for name in names if options.get(name, _OF_ALL.get(name)) != _OF_ALL.get(name)}


def _notes(config: Mapping[str, Any], env_options: Mapping[str, str]) -> str:
    preset = str(config.get("preset"))
    fps = config.get("control_fps") or (env_options.get("control") == DENSE and env_options.get("fps", 10))
    action = f"It acts at control rate, {fps} Hz." if fps else _KEY_FRAME if "control_fps" in config else ""
    first = f"{action} {_METHODS.get(preset, '')}".strip()
    remembers = preset in ("keyframe", "dense") and config.get("n_action_history_steps")
    return f"{first}\n{_CONTACTS}" if remembers else first


def _dataset_of(training: Mapping[str, Any]) -> str | None:
    name = (training.get("dataset") or {}).get("repo_id")
    return name if isinstance(name, str) and name.count("/") == 1 and not name.startswith("local/") else None


def _facts(checkpoint: Checkpoint) -> str:
    config = checkpoint.config
    rows = [(f"input `{key}`", _feature(key, each)) for key, each in (config.get("input_features") or {}).items()]
    rows += [(f"output `{key}`", _feature(key, each)) for key, each in (config.get("output_features") or {}).items()]
    used = [key for key in _ROWS if config.get(key) is not None]
    rows += [(_ROWS[key][0], _ROWS[key][1].format(config[key])) for key in used]
    averaged = "" if checkpoint.updates is None else f"; averaged over {checkpoint.updates} updates"
    rows.append(("size", f"{checkpoint.parameters / 1e6:.1f} M parameters{averaged}"))
    return "\n".join(f"| {name} | {text} |" for name, text in rows)


def _feature(key: str, feature: Mapping[str, Any]) -> str:
    return f"{tuple(feature['shape'])}: {COLUMNS.get(key, feature['type'])}"


def _training(training: Mapping[str, Any], dataset: str | None) -> str:
    if not training:
        return "How it was trained is not recorded."
    options = ", ".join(f"{name.replace('_', ' ')} {training[name]}" for name in _TRAINING if name in training)
    source = f"`{dataset}`" if dataset else "a dataset that is not published"
    goes_on = bool((training.get("policy") or {}).get("pretrained_path")) and not training.get("resume")
    start = " It went on from the weights of an earlier training." if goes_on else ""
    return f"On {source}: {options}.{start} `train_config.json` holds every option; local paths are removed from it."


def train_command(training: Mapping[str, Any], repo_id: str, kind: str, dataset: str | None) -> str:
    """Returns a command that trains with all options of ``train_config.json``, or if it is unknown with defaults."""
    begin = f"--config_path={repo_id}" if training else f"--policy.type={kind}"
    data = "" if training and dataset else f" --dataset.repo_id={dataset or 'DATASET'}"
    return f"lerobot-train {begin}{data} --policy.push_to_hub=false --output_dir=outputs/again"
