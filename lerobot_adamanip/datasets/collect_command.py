"""The `adamanip collect` command that reproduces a dataset, for its card."""

from __future__ import annotations

import dataclasses
from typing import Any

from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.contract.categories import ALL
from lerobot_adamanip.datasets.collection_spec import MANIFEST_FIELDS, CollectionSpec
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.util.errors import ConfigurationError

PYTHON_ONLY = ("max_key_frames", "hidden_overrides", "workspace")
"""Fields without an option of `adamanip collect`."""


def collect_command(spec: CollectionSpec, folder: str) -> str:
    """Returns the command that collects a dataset with these options into ``folder``.

    Local folders of a policy and of external assets are written as POLICY and ASSETS. Values without an option are
    listed in a comment.
    """
    values: dict[str, Any] = {"category": spec.category, "objects": _objects(spec)}
    own = {field.name: getattr(spec, field.name) for field in dataclasses.fields(spec)}
    values |= {name: value for name, value in own.items() if name not in ("environment", "objects")}
    values |= {name: getattr(spec.environment, name) for name in MANIFEST_FIELDS if name not in PYTHON_ONLY}
    if spec.policy:
        values["policy"] = "POLICY"
    else:
        del values["policy"], values["expert_share"]
    if spec.environment.assets is not None:
        values["assets"] = "ASSETS"
    flags = [flag for name, value in values.items() if (flag := _flag(name, value))]
    line = f"adamanip collect {folder} {' '.join(flags)}"
    return "\n".join([*_comments(spec), line])


def _flag(name: str, value: object) -> str:
    if value is None:
        return ""
    if name == "observe_images":
        return "" if value else "--no-images"  # --image-size requires images
    option = f"--{name.replace('_', '-')}"
    if isinstance(value, bool):
        return option if value else ""  # flags are off by default
    return f"{option} {value}"


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


def _comments(spec: CollectionSpec) -> list[str]:
    told = [f"# policy {spec.policy}"] if spec.policy else []
    default = EnvironmentOptions()
    for name in PYTHON_ONLY:
        if (value := getattr(spec.environment, name)) != getattr(default, name):
            plain = dict(value) if name == "hidden_overrides" else value
            told.append(f"# and {name}={plain}, which has no option: EnvironmentOptions in Python")
    if spec.category == ALL and "," in _objects(spec):
        told.append("# and these objects, which no selection of all categories gives: CollectionSpec in Python")
    return told
