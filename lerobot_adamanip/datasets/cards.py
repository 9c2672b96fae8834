"""Cards for the Hub: templates of ``hub_cards/``, the README of a dataset, and an offline check."""

from __future__ import annotations

import dataclasses
import importlib.resources
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

from packaging.version import Version

from lerobot_adamanip import __version__
from lerobot_adamanip.assets import is_asset_id
from lerobot_adamanip.catalog import category_of, select_objects
from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.cameras import CAMERAS, image_column, is_image_column
from lerobot_adamanip.contract.categories import ALL
from lerobot_adamanip.contract.control import (
    ACTION_NAMES,
    DELTA_POSITION,
    DELTA_ROTATION,
    EE_DELTA,
    EE_POSE,
    JOINT,
    STATES,
)
from lerobot_adamanip.contract.memory import MEMORY, NO_MEMORY
from lerobot_adamanip.contract.sensing import EXACT
from lerobot_adamanip.contract.versions import joined_versions, mixed_versions
from lerobot_adamanip.datasets.attempts import attempts_path, grouped_by_hidden_value, read_attempts
from lerobot_adamanip.datasets.check.features import OF_LEROBOT
from lerobot_adamanip.datasets.collection_spec import (
    MANIFEST_FIELDS,
    OF_PICTURES,
    OPTIONAL_FIELDS,
    CollectionSpec,
    manifest_path,
)
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.dense import is_dense_collection, kind_by_size
from lerobot_adamanip.datasets.episode import EpisodeDescription
from lerobot_adamanip.datasets.manifest import Manifest
from lerobot_adamanip.datasets.selection import selection_path
from lerobot_adamanip.datasets.stats import episode_records
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.evaluation.failed_tries import failed_tries_by_kind, failed_tries_text
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.json_fields import parse

LICENSE = "apache-2.0"
TAGS = ("LeRobot", "lerobot_env_adamanip", "adamanip", "point-cloud", "articulated-objects", "simulation")
TEMPLATES = (
    "dataset_card.md",
    "dense_card.md",
    "recorded_card.md",
    "model_card.md",
    "environment_card.md",
    "citation.md",
    "env.py",
)
COLUMNS = {
    schema.POINT_CLOUD: "m; x, y, z of each point, farthest first, so any prefix is itself a farthest-point sample",
    schema.STATE: "tool position, rotation 6D, gripper opening, 7 joint positions [rad], 7 joint velocities [rad/s]",
    schema.EFFORT: "external joint torque [N m]",
    schema.FRONT_IMAGE: "RGB",
    schema.ACTION: "goal: position [m], rotation 6D, gripper (0 closed, 1 open)",
    schema.PHASE: "what the expert is doing: 0 approach, 1 grasp, 2 try, 3 release, 4 unlock, 5 open",
    schema.TRIAL: "failed tries before this row",
    schema.OUTCOME: "of this row's action: 0 reached, 1 stalled, 2 time limit, 3 unreachable",
    schema.TRIED: "joint that this row's action tried to move: 0 the one that opens, 1 and up the others, -1 none",
    schema.FAILED: "whether that try failed: the joint did not move",
    schema.PROGRESS: "how far that joint moved, in the direction it was sent [rad or m]",
    schema.EXECUTED: "what the arm was sent: `action`, but where a policy drove or a mistake was made, and `action` "
    "corrects it",
    schema.JOINTS: "positions of all joints, from which `adamanip render` makes pictures: never a policy's input",
    schema.SUCCESS: "whether the task is done after this row's action",
    schema.DONE: "true in an episode's last row: the final observation; its action stays in place and was not sent",
}
"""Column -> meaning."""
MEMORY_MEANING = "the latest four felt tries, from tool poses and commands alone: a policy may use them"
DENSE_COLUMNS = {
    **COLUMNS,
    schema.STATE: "see above",
    schema.ACTION: "see above; row t's action is sent after row t's observation",
    schema.OUTCOME: "of the key frame, in its last row: 0 reached, 1 stalled, 2 time limit, 3 unreachable; else -1",
    schema.TRIED: "joint of the try that goes on: 0 the one that opens, 1 and up the others, -1 none",
    schema.DIRECTION: "sign of that try; 0 without one",
    schema.FAILED: "whether that try fails: the joint will not have moved by its end",
    schema.PROGRESS: "how far that joint moved in this row, in the direction of the try [rad or m]",
    schema.KEY_FRAME: "the expert's key frame: position [m], rotation 6D, gripper (0 closed, 1 open)",
}
"""Column of a dataset at control rate -> meaning."""
ACTION_MEANINGS = {
    EE_DELTA: f"Action `{EE_DELTA}`: translation in units of {DELTA_POSITION:g} m and rotation vector in units of "
    f"{DELTA_ROTATION:g} rad from the measured tool pose, along the base's axes, "
    "within -1 ... 1; gripper -1 closed, 1 open.",
    EE_POSE: f"Action `{EE_POSE}`: the tool's pose: position [m], rotation 6D, gripper (0 closed, 1 open).",
    JOINT: f"Action `{JOINT}`: positions of the arm's joints [rad], gripper (0 closed, 1 open).",
}
_SIZES = (
    (1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"), (10_000_000, "1M<n<10M"),
    (100_000_000, "10M<n<100M"), (1_000_000_000, "100M<n<1B"),
)  # fmt: skip
"""Number of rows, and the Hub's size category for datasets with fewer rows."""
PYTHON_ONLY = ("max_key_frames", "hidden_overrides", "workspace")
"""Options of a manifest that `adamanip collect` lacks."""


# Templates ------------------------------------------------------------------------------------------------------------


def card_template(name: str) -> Template:
    """Returns a template of ``hub_cards/``, which is beside the package in a checkout and inside it in a wheel."""
    package = importlib.resources.files("lerobot_adamanip")
    template = package / "hub_cards" / name
    if isinstance(package, Path) and not template.is_file():
        template = package.parent / "hub_cards" / name
    return Template(template.read_text(encoding="utf-8"))


def template_texts() -> Iterator[str]:
    """Yields the text of every template."""
    return (card_template(name).template for name in TEMPLATES)


def shared_fields(extra: str = "[sim]", *, commit: str = "") -> dict[str, str]:
    """Returns the fields of every card.

    ``citation`` is its end: citation, and the origins of code and objects. ``install`` are the shell lines that install
    this version with ``extra``; a development version, of ``commit``, is on no package index.
    """
    where = f" at commit {commit[:10]}" if commit else ""
    install = f"# {__version__} is no release: in a checkout of its repository{where}\npip install '.{extra}'"
    if not Version(__version__).is_devrelease:
        install = f"pip install '{requirement(extra)}'"
    return {"citation": card_template("citation.md").template.strip(), "install": install}


def requirement(extra: str = "[sim]") -> str:
    """Returns the requirement of this version or, for a development version, also of the release that follows it."""
    return f"lerobot_env_adamanip{extra}{'>=' if Version(__version__).is_devrelease else '=='}{__version__}"


def front_matter(kind: str, fields: Mapping[str, Any]) -> str:
    """Returns the YAML header of a ``dataset`` or ``model`` card, generated by the Hub's library.

    ``fields`` are of ``DatasetCardData`` or ``ModelCardData``; ``eval_results`` become ``model-index``.
    """
    from huggingface_hub import DatasetCardData, ModelCardData

    data = (DatasetCardData if kind == "dataset" else ModelCardData)(**fields)
    return f"---\n{data.to_yaml().strip()}\n---"


def check_card(text: str, kind: str) -> None:
    """Checks a ``dataset`` or ``model`` card offline; the Hub checks it again on upload.

    Raises:
        DatasetError: the header is not YAML, lacks a licence, or has a malformed ``model-index`` or dataset name; or
            the text has a placeholder left.
    """
    from huggingface_hub import DatasetCard, ModelCard
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]
    from yaml import YAMLError

    try:
        card = (DatasetCard if kind == "dataset" else ModelCard)(text)
        if not getattr(card.data, "license", None):
            raise ValueError("its header names no license")
        for name in getattr(card.data, "datasets", None) or ():
            validate_repo_id(name)
        if left := re.search(r"\$[a-z_]+\b", card.text):
            raise ValueError(f"the placeholder {left.group()} was left")
    except (ValueError, YAMLError) as error:
        raise DatasetError(
            "The card is not valid.",
            got=str(error)[:400],
            allowed="a header that the Hub understands",
            hint="README.md",
        ) from error


# Datasets -------------------------------------------------------------------------------------------------------------


def dataset_card(folder: Path, name: str, repo_id: str, assets: str | Path | None = None) -> str:
    """Returns the README of a finished dataset. It contains no local path.

    Args:
        folder: folder of the dataset.
        name: name of the output folder in the card's `adamanip collect` command.
        repo_id: its name on the Hub.
        assets: folder of the external assets of the collection, if any.

    Raises:
        DatasetError: the manifest or the list of attempts is damaged, or episodes do not say how they were made.
    """
    dataset = Dataset(folder)
    is_dense = is_dense_collection(dataset.features)
    fields = _common_fields(dataset, name, repo_id)
    if any(episode.row.get("recorded") is not None for episode in dataset.episodes):
        return card_template("recorded_card.md").substitute({**fields, **shared_fields("")}, **_sources(dataset))
    manifest = dataset.manifest(assets) if manifest_path(folder).exists() else None
    episodes = dataset.descriptions()
    return card_template("dense_card.md" if is_dense else "dataset_card.md").substitute(
        {**fields, **(_dense_fields(dataset, manifest) if is_dense else {})},
        **_counts(episodes),
        failed_kinds="; ".join(failed_tries_text(failed_tries_by_kind(episode_records(dataset)))) or "none",
        **_attempts(dataset, manifest, episodes),
        **_scene(dataset, manifest, episodes),
        **_origin(dataset, manifest, episodes, name.removesuffix("-failed")),
        root_option=" --dataset.root=DIR" if repo_id.startswith("local/") else "",
    )


def _dense_fields(dataset: Dataset, manifest: Manifest | None) -> dict[str, object]:
    """Returns the fields of a dataset at control rate: kinds of action and state, cameras, and a policy's options."""
    action, state = (kind_by_size(dataset.features, key) for key in (schema.ACTION, schema.STATE))
    cameras = [name for name in CAMERAS if image_column(name) in dataset.features]
    has_cloud = schema.POINT_CLOUD in dataset.features
    options = {"control": "dense", "fps": dataset.fps, "action": action, "state": state}
    size = ""
    if cameras:
        height, width = dataset.features[image_column(cameras[0])]["shape"][:2]
        size = f", {width} x {height} pixels"
        options["image_size"] = height
        options |= {} if cameras == list(CAMERAS) else {"cameras": f"'[{','.join(cameras)}]'"}
    options |= {"observe_cloud": "true"} if has_cloud else {}
    options |= {"memory": dataset.memory} if dataset.memory != NO_MEMORY else {}
    if manifest is not None:
        made = manifest.spec.environment
        options |= {"image_source": made.images_from} if cameras else {}
        options |= {"num_points": made.num_points} if has_cloud else {}
        options |= {"sensing": made.sensing} if made.sensing != EXACT else {}
        options |= {"self_calibration": "true"} if made.self_calibration else {}
    options |= {"observe_effort": "true"} if schema.EFFORT in dataset.features else {}
    return {
        "action": action,
        "state": state,
        "action_names": ", ".join(ACTION_NAMES[action]),
        "state_names": ", ".join(STATES[state]),
        "action_meaning": ACTION_MEANINGS[action],
        "cameras": ", ".join(f"`{name}`" for name in cameras) + size if cameras else "none",
        "policy": "act" if cameras or not has_cloud else "dp3_adaptive",
        "env_options": " ".join(f"--env.{name}={value}" for name, value in options.items()),
    }


def _common_fields(dataset: Dataset, name: str, repo_id: str) -> dict[str, object]:
    rows = dataset.info["total_frames"]
    header = {
        "license": LICENSE,
        "task_categories": ["robotics"],
        "tags": list(TAGS),
        "pretty_name": f"AdaManip demonstrations ({name})",
        "size_categories": [next((text for limit, text in _SIZES if rows < limit), "1B<n<10B")],
        "configs": [{"config_name": "default", "data_files": "data/*/*.parquet"}],
    }
    lines = []
    for key, feature in dataset.features.items():
        if key not in OF_LEROBOT:
            meanings = DENSE_COLUMNS if is_dense_collection(dataset.features) else COLUMNS
            meaning = meanings.get(schema.FRONT_IMAGE if is_image_column(key) else key, "")
            meaning = MEMORY_MEANING if key == MEMORY else meaning
            kind = "video, " if feature["dtype"] == "video" else ""
            lines.append(f"| `{key}` | {kind}{tuple(feature['shape'])} | {meaning} |")
    return {
        "front_matter": front_matter("dataset", header),
        "repo_id": repo_id,
        "episodes": len(dataset),
        "frames": rows,
        "key_frames": rows - len(dataset),
        "features": "\n".join(lines),
        "fps": dataset.fps,
        **shared_fields(),
    }


def _sources(dataset: Dataset) -> dict[str, object]:
    """Returns the fields of a dataset with episodes of a robot."""
    rows = [episode.row for episode in dataset.episodes]
    try:
        sources = Counter(map(_source, rows))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(
            "The episodes do not say how they were made.",
            got=f"{dataset.root.name}: {type(error).__name__} {error}"[:400],
            allowed="the columns that `adamanip keyframes` writes into meta/episodes",
            hint="adamanip keyframes RECORDING --out DATASET",
        ) from error
    lines = "\n".join(f"| {count} | {source} |" for source, count in sources.items())
    return {"successes": sum(bool(row.get("success")) for row in rows), "sources": lines}


def _source(row: Mapping[str, Any]) -> str:
    """Returns table cells with the source of an episode, and whether its tries are labelled."""
    if row.get("recorded") is None:
        return f"simulated, {category_of(row['object_id']).replace('_', ' ')} | yes"
    recorded = parse(row["recorded"])
    corrections = ", corrections of a policy" if recorded.get("corrections") else ""
    return f"robot `{recorded['robot_type']}`, recording `{recorded['recording']}`{corrections} | no"


def _origin(
    dataset: Dataset, manifest: Manifest | None, episodes: Sequence[EpisodeDescription], folder: str
) -> dict[str, str]:
    categories = list(dict.fromkeys(category_of(episode.object_id) for episode in episodes))
    is_mixed = len(categories) > 1 if manifest is None else manifest.spec.category == ALL
    selection = dataset.selection if selection_path(dataset.root).exists() else None
    origin = "Put together of several collections, or of a part of one: each episode's columns say how it was made."
    if manifest is not None:
        origin = f"```bash\n{collect_command(manifest.spec, 'DATASET' if selection else folder)}\n```"
    if selection is not None:
        commands = "\n".join(selection.made_with)
        commands = f", made with\n\n```bash\n{commands}\n```" if commands else "."
        part = f"Part of `DATASET`: {len(selection.episodes)} of its {selection.source_episodes} episodes"
        origin = f"{part}, listed in `meta/selection.json`{commands}\n\nHow `DATASET` was made:\n\n{origin}"
    return {
        "title": "all categories" if is_mixed else categories[0].replace("_", " "),
        "env_type": "adamanip" if is_mixed else f"adamanip_{categories[0]}",
        "expert": "/".join(sorted({str(episode.expert) for episode in episodes})),
        "made": origin,
    }


def _scene(dataset: Dataset, manifest: Manifest | None, episodes: Sequence[EpisodeDescription]) -> dict[str, object]:
    pictures = "There are no pictures (`adamanip render` adds them)"
    if columns := [key for key in dataset.features if is_image_column(key)]:
        height, width = dataset.features[columns[0]]["shape"][:2]
        names = ", ".join(f"`{key}`" for key in columns)
        pictures = f"Pictures ({names}) have {width} x {height} pixels, RGB"
    poses = {json.dumps(each.camera.get("extrinsics", each.camera), sort_keys=True) for each in episodes}
    moves = "its pose is drawn anew for each episode" if len(poses) > 1 else "its pose is the same in all episodes"
    external = any(is_asset_id(episode.object_id) for episode in episodes)
    objects = " from external models" if external else ", generated from parameters"
    exact = manifest is None or manifest.spec.environment.sensing == EXACT
    return {
        "pictures": pictures,
        "camera_pose": moves,
        "kind_of_objects": objects,
        "sensing": "without a depth camera's noise, holes and reflections" if exact else "with simulated sensor errors",
    }


def _counts(episodes: Sequence[EpisodeDescription]) -> dict[str, object]:
    successes = sum(episode.success for episode in episodes)
    tries = Counter(episode.failed_tries for episode in episodes)
    opened = Counter(episode.failed_tries for episode in episodes if episode.success)
    kept = {0: "Only episodes that failed are in it", len(episodes): "Only episodes that ended in success are in it"}
    versions = [dict(episode.versions) for episode in episodes]
    mixed = mixed_versions({**each, "cpu": ""} for each in versions)
    return {
        "split": "" if successes else ", failed episodes",
        "kept": kept.get(successes, f"{successes} of its episodes ended in success"),
        "objects": len({episode.object_id for episode in episodes}),
        "late": sum(episode.late for episode in episodes),
        "recovered": sum(count for failed, count in opened.items() if failed),
        "trial_table": "\n".join(f"| {failed} | {tries[failed]} | {opened[failed]} |" for failed in sorted(tries)),
        "versions": ", ".join(f"{name} {version}" for name, version in sorted(joined_versions(versions).items())),
        "mixed": f" Note: its episodes were recorded with different versions: {mixed}." if mixed else "",
    }


def _attempts(dataset: Dataset, manifest: Manifest | None, episodes: Sequence[EpisodeDescription]) -> dict[str, object]:
    """Returns the counts of the collection's attempts, or of the episodes if the attempts are unknown."""
    is_part = selection_path(dataset.root).exists()
    counts = None if manifest is None or is_part else manifest.attempts
    if counts is None:
        account, titles = "the source collections list the attempts", "| hidden | episodes | of them succeeded |"
        groups: Mapping[str, Sequence[Any]] = grouped_by_hidden_value(episodes)
    else:
        attempts = read_attempts(attempts_path(dataset.root))
        succeeded = sum(attempt.success for attempt in attempts)
        account = (
            f"for the collection {counts.attempted} episodes were attempted: {succeeded} "
            f"({100.0 * succeeded / max(1, counts.attempted):.1f} %) succeeded,\n{counts.kept} were kept, and "
            f"{counts.given_up} wanted episodes were given up"
        )
        titles = "| hidden | attempted | of them succeeded | of them kept |"
        groups = grouped_by_hidden_value(attempts)
    lines = [titles, "|---" * (titles.count("|") - 1) + "|"]
    for label, group in groups.items():
        kept = f" {sum(each.kept for each in group)} |" if counts is not None else ""
        lines.append(f"| `{label}` | {len(group)} | {sum(each.success for each in group)} |{kept}")
    return {"account": account, "hidden_table": "\n".join(lines)}


# Command --------------------------------------------------------------------------------------------------------------


def collect_command(spec: CollectionSpec, folder: str) -> str:
    """Returns the `adamanip collect` command that collects a dataset with these options into ``folder``.

    Local folders of a policy and of external assets are written as POLICY and ASSETS. Values without an option are
    listed in a comment.
    """
    environment = spec.environment
    values: dict[str, Any] = {"category": spec.category, "objects": _objects(spec)}
    values |= {item.name: getattr(spec, item.name) for item in dataclasses.fields(spec) if item.name not in values}
    values |= {name: getattr(environment, name) for name in MANIFEST_FIELDS if name not in PYTHON_ONLY}
    values |= {name: getattr(environment, name) for name in OF_PICTURES}
    chosen = {name: getattr(environment, name) for name in OPTIONAL_FIELDS}
    values |= {name: value for name, value in chosen.items() if value != OPTIONAL_FIELDS[name]}
    if environment.is_dense:
        values |= {name: getattr(environment, name) for name in ("control", "fps", "action", "state")}
        values |= {"cloud": environment.observe_cloud, "effort": environment.observe_effort}
    if values["cameras"] is not None:
        values["cameras"] = " ".join(values["cameras"])
    values |= {"environment": None, "assets": None if environment.assets is None else "ASSETS"}
    images = values.pop("observe_images")
    values["mistakes"] = spec.mistakes or None
    values |= {"policy": "POLICY"} if spec.policy else {"policy": None, "expert_share": None}
    options = {f"--{name.replace('_', '-')}": value for name, value in values.items() if value is not None}
    words = [name if value is True else f"{name} {value}" for name, value in options.items() if value is not False]
    words += [] if images else ["--no-images"]  # --image-size requires images
    line = " ".join([f"adamanip collect {folder}", *words])
    comments = [f"# policy {spec.policy}"] if spec.policy else []
    for name in (*PYTHON_ONLY, "max_steps"):
        if (value := getattr(environment, name)) != getattr(EnvironmentOptions(), name):
            plain = dict(value) if name == "hidden_overrides" else value
            comments.append(f"# and {name}={plain}, which has no option: EnvironmentOptions in Python")
    if spec.category == ALL and "," in values["objects"]:
        comments.append("# and these objects, which no selection of all categories gives: CollectionSpec in Python")
    return "\n".join([*comments, line])


def _objects(spec: CollectionSpec) -> str:
    """Returns the shortest selection of the objects: a split, a range of numbers, or else all ids."""
    first, last = (name.rpartition("_")[2] for name in (spec.objects[0], spec.objects[-1]))
    ranges = [f"{int(first)}:{int(last) + 1}"] if first.isdecimal() and last.isdecimal() else []
    for selection in ("seen", "unseen", "novel", *ranges):
        try:
            chosen = [select_objects(each, selection, spec.environment.assets) for each in spec.categories]
        except ConfigurationError:
            continue
        if tuple(name for ids in chosen for name in ids) == spec.objects:
            return selection
    return ",".join(spec.objects)
