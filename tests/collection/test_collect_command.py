"""The command on a card gives the same collection again, whatever its options."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from lerobot_adamanip.catalog import select_objects
from lerobot_adamanip.cli.main import parse_command
from lerobot_adamanip.collection import trained_policy
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.datasets.cards import PYTHON_ONLY, collect_command
from lerobot_adamanip.datasets.collection_spec import MANIFEST_FIELDS, OPTIONAL_FIELDS, CollectionSpec
from lerobot_adamanip.datasets.manifest import Manifest
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_env_adamanip.sim import render_device

_CHANGED: dict[str, Any] = {
    "expert": "static", "expert_strategy": "to_stop", "episodes_per_object": 7, "trials": 2, "seed": 5,
    "late_starts": 0.25, "keep_failed": True, "policy": "a" * 32, "expert_share": 0.75, "num_points": 512,
    "image_size": 32, "observe_images": True, "cloud_source": "render", "poses": "fixed", "mechanism_rules": "hard",
    "max_failed_tries": "best", "sensing": "d435,camera_error_mm=20", "self_calibration": True, "hints": 0.5,
    "memory": "text", "mistakes": 0.25,
}  # fmt: skip
"""Another value than the default for every field that a command can set."""


@pytest.fixture(autouse=True)
def _something_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render_device, "can_render", lambda: True)


def _parsed(command: str) -> CollectionSpec:
    """As `adamanip` itself parses it."""
    return parse_command("collect", command.splitlines()[-1].split()[2:]).spec()  # type: ignore[no-any-return]


def _options(spec: CollectionSpec) -> object:
    """All that decides which data a collection holds."""
    return Manifest(spec).to_json()["collection"]


def test_every_option_of_a_collection_can_be_given_by_its_command_or_is_known_to_have_none() -> None:
    fields = {field.name for field in dataclasses.fields(CollectionSpec)} - {"environment", "objects"}
    assert {*_CHANGED, *PYTHON_ONLY} == fields | {*MANIFEST_FIELDS, *OPTIONAL_FIELDS}


@pytest.mark.parametrize("name", sorted(_CHANGED))
def test_a_command_parses_back_to_its_collection(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trained_policy, "policy_hash", lambda folder: "a" * 32)
    spec = CollectionSpec(EnvironmentOptions(), ("safe_000", "safe_001"))
    value = _CHANGED[name]
    if name in (*MANIFEST_FIELDS, *OPTIONAL_FIELDS):
        changed = dataclasses.replace(spec, environment=spec.environment.changed(**{name: value}))
    elif name in ("policy", "expert_share"):
        changed = dataclasses.replace(spec, policy="a" * 32, expert_share=0.3 if name == "policy" else value)
    else:
        changed = dataclasses.replace(spec, **{name: value})
    assert _options(changed) != _options(spec)
    assert _options(_parsed(collect_command(changed, "demos"))) == _options(changed)


@pytest.mark.parametrize(
    ("category", "selection"),
    [("safe", "0:3"), ("door", "seen"), ("pen", "unseen"), ("lamp", "n0:n2"), ("safe", "safe_003,safe_001")],
)
def test_a_command_names_the_objects(category: str, selection: str) -> None:
    environment = EnvironmentOptions(category, objects=selection)
    spec = CollectionSpec(environment, select_objects(category, selection))
    assert _options(_parsed(collect_command(spec, "demos"))) == _options(spec)


def test_the_command_of_all_categories_is_short() -> None:
    objects = tuple(name for category in CATEGORIES for name in select_objects(category, "seen"))
    spec = CollectionSpec(EnvironmentOptions(next(iter(CATEGORIES))), objects)
    command = collect_command(spec, "demos")
    assert "--category all --objects seen " in command
    assert _options(_parsed(command)) == _options(spec)


def test_what_no_option_sets_stands_in_a_comment() -> None:
    spec = CollectionSpec(EnvironmentOptions(max_key_frames=20, hidden_overrides={"locked": True}), ("safe_000",))
    comments = [line for line in collect_command(spec, "demos").splitlines() if line.startswith("# ")]
    assert len(comments) == 2
    assert "max_key_frames=20" in comments[0]
    assert "hidden_overrides={'locked': True}" in comments[1]


@pytest.mark.parametrize("memory", ["events", "text"])
def test_a_command_names_a_memory_and_a_default_one_has_neither_option(memory: str) -> None:
    plain = CollectionSpec(EnvironmentOptions(), ("safe_000",))
    assert not {"memory", "mistakes"} & {*_flat(plain)}
    assert not any(word in collect_command(plain, "demos") for word in ("--memory", "--mistakes"))
    spec = dataclasses.replace(plain, environment=EnvironmentOptions(memory=memory))
    assert _flat(spec)["memory"] == memory
    assert _options(_parsed(collect_command(spec, "demos"))) == _options(spec)


def _flat(spec: CollectionSpec) -> dict[str, Any]:
    content = Manifest(spec).to_json()["collection"]
    return {**content, **content["environment"]}
