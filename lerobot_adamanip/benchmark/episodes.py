"""Check of an evaluation's episodes: whether they are those that its command requests."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from lerobot_adamanip.benchmark.plan import ENV_TYPE, TYPE_PREFIX
from lerobot_adamanip.catalog import parse_object_selection
from lerobot_adamanip.contract.control import DENSE
from lerobot_adamanip.episode.options import BEST, EnvironmentOptions
from lerobot_adamanip.evaluation.record import EpisodeRecord
from lerobot_adamanip.mechanisms.best_tries import best_tries

_UNSET = ("null", "None")
_TEXTS = ("objects", "poses", "mechanism_rules", "sensing", "max_failed_tries", "control")


def differing_episodes(records: Sequence[EpisodeRecord], options: Mapping[str, str]) -> str:
    """Returns in what episodes differ from their evaluation's options, ``poses fixed, not randomized``; empty if none.

    Split of the scenes and simulation version are not compared.

    Args:
        records: the counted episodes.
        options: name -> value, see `lerobot_adamanip.benchmark.plan.evaluation_options`.
    """
    chosen = _environment(options)
    # External assets are of no selection.
    objects = None if "--env.assets" in options else parse_object_selection(chosen.category, chosen.objects)
    differences: dict[str, None] = {}
    ordered = sorted(records, key=lambda record: record.given_seed)
    for record, seed in zip(ordered, itertools.count(int(options["--seed"])), strict=False):
        limit = chosen.max_failed_tries
        if limit == BEST:
            _, limit = best_tries(chosen.category, chosen.mechanism_rules, record.hidden_state)
        pairs = {
            "category": (record.category, chosen.category),
            "rules": (record.provenance.mechanism_rules, chosen.mechanism_rules),
            "poses": (record.poses, chosen.poses),
            "sensing": (record.sensing, chosen.sensing),
            "hints": (record.hints, chosen.hints),
            "limit of failed tries": (record.max_failed_tries, limit),
            "limit of steps": (record.max_key_frames, chosen.step_limit),
            "seed": (record.given_seed, seed),
        }
        differences |= {f"{name} {got}, not {asked}": None for name, (got, asked) in pairs.items() if got != asked}
        if objects is not None and record.object_id not in objects:
            differences[f"object {record.object_id}, not of {chosen.objects}"] = None
    return "; ".join(itertools.islice(differences, 10))


def _environment(options: Mapping[str, str]) -> EnvironmentOptions:
    """Returns the options of the environment that decide a record."""
    stripped = {name.removeprefix("--env."): value.strip("'\" ") for name, value in options.items()}  # YAML's quotes
    named = {name: value for name, value in stripped.items() if value not in _UNSET}
    values: dict[str, Any] = {name: named[name] for name in _TEXTS if name in named}
    values |= {name: convert(named[name]) for name, convert in (("hints", float), ("fps", int)) if name in named}
    if "episode_length" in named:
        limit = "max_steps" if named.get("control") == DENSE else "max_key_frames"
        values[limit] = int(named["episode_length"])
    if "assets" in named:
        del values["objects"]
    return EnvironmentOptions(category=options[ENV_TYPE].removeprefix(TYPE_PREFIX), **values)
