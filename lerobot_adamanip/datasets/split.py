"""`adamanip split`: divide a dataset into parts, which are datasets themselves."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.datasets.compose import Progress, compose
from lerobot_adamanip.datasets.conditions import Facts, as_text
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.episode_facts import episode_facts
from lerobot_adamanip.datasets.output_folder import WRITING, owned_output
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError

EPISODE = "episode_index"
_ROUNDING = 1e-6
Parts = Mapping[str, Sequence[int]]
"""Name of a part -> its episode indices, ascending."""


def split_episodes(
    root: Path,
    out: Path,
    shares: Mapping[str, float] | None,
    *,
    by: str = EPISODE,
    seed: int = 0,
    progress: Progress = lambda done, total: None,
) -> Parts:
    """Writes each episode of a dataset to one of several parts; returns the episodes of each part.

    Args:
        root: of a dataset.
        out: folder of the parts, which must not exist.
        shares: name of a part -> its share; they add up to 1. None makes one part for each value of ``by``.
        by: column, see `episode_facts`. Episodes with equal values stay together; shares are of the values.
        seed: of the random assignment.
        progress: called after each episode.

    Raises:
        ConfigurationError: the shares do not add up to 1, the column is unknown, or there are fewer values than parts.
        DatasetError: the dataset is damaged, or ``out`` exists.
    """
    with owned_output(out, WRITING) as output:
        output.require_free()
        source = Dataset(root, recordings=True)
        parts = assign(episode_facts(source), shares, by=by, seed=seed)
        output.require_room(files.tree_bytes(source.root))
        built = output.fresh("dataset")
        built.mkdir()
        command = [*_command(shares, by, seed), "--out", output.root.name]
        before, total = 0, len(source)
        for name, chosen in parts.items():
            pieces, selection = [(source, episode) for episode in chosen], source.selection.of(chosen, command)
            compose(built / name, pieces, f"local/{name}", selection, functools.partial(_tell, progress, before, total))
            before += len(chosen)
        files.sync(built)
        output.publish(built)
    return parts


def _command(shares: Mapping[str, float] | None, by: str, seed: int) -> list[str]:
    said = [] if shares is None else ["--parts", ",".join(f"{name}={share:g}" for name, share in shares.items())]
    return ["adamanip", "split", "DATASET", *said, "--by", by, "--seed", str(seed)]


def _tell(progress: Progress, before: int, total: int, done: int, _: int) -> None:
    progress(before + done, total)


def assign(facts: Sequence[Facts], shares: Mapping[str, float] | None, *, by: str, seed: int) -> Parts:
    """Returns the episodes of each part, see `split_episodes`; depends on its arguments only."""
    groups = _groups(facts, by)
    if shares is None:
        return {_folder_name(by, value): episodes for value, episodes in groups.items()}
    _check_shares(shares, len(groups), by)
    values = [list(groups)[place] for place in np.random.default_rng(seed).permutation(len(groups))]
    parts: dict[str, list[int]] = {}
    for name, count in zip(shares, _counts(list(shares.values()), len(values)), strict=True):
        mine, values = values[:count], values[count:]
        parts[name] = sorted(episode for value in mine for episode in groups[value])
    return parts


def _groups(facts: Sequence[Facts], by: str) -> dict[Any, list[int]]:
    """Returns value -> its episodes, ordered by value. Numbers are texts in a column that has texts as well."""
    found: dict[Any, list[int]] = {}
    has_texts = any(isinstance(each.get(by), str) for each in facts)
    for number, each in enumerate(facts):
        value = each.get(by)
        found.setdefault(value if value is None or not has_texts else as_text(value), []).append(number)
    if None in found:
        known = [name for name in facts[0] if all(each.get(name) is not None for each in facts)]
        raise ConfigurationError(
            "Not every episode has this column.", got=repr(by), allowed=", ".join(known), hint="--by object_id"
        )
    return {value: found[value] for value in sorted(found)}


def _folder_name(by: str, value: Any) -> str:
    text = as_text(value)
    if re.fullmatch(r"(?!\.)[\w.-]{1,100}", text) is None:
        raise ConfigurationError(
            "A value cannot be the name of a folder.",
            got=f"{by} = {text[:100]!r}",
            allowed="letters, digits, _, - and .",
            hint="--parts train=0.8,validation=0.2",
        )
    return text


def _check_shares(shares: Mapping[str, float], groups: int, by: str) -> None:
    if len(shares) < 2 or min(shares.values()) <= 0 or abs(sum(shares.values()) - 1) > _ROUNDING:
        raise ConfigurationError(
            "These are not shares of one dataset.",
            got=", ".join(f"{name}={share:g}" for name, share in shares.items()),
            allowed="two or more shares above 0 that add up to 1",
            hint="--parts train=0.8,validation=0.2",
        )
    if groups < len(shares):
        raise ConfigurationError(
            "There are fewer values than parts.",
            got=f"{groups} different {by} for {len(shares)} parts",
            allowed="at least as many values as parts",
            hint="fewer parts, or without --by",
        )


def _counts(shares: Sequence[float], total: int) -> list[int]:
    """Returns the count of each share of ``total``, by largest remainders; at least one each."""
    exact = np.multiply(shares, total)
    counts = np.maximum(1, (exact + _ROUNDING).astype(int))
    while counts.sum() < total:
        counts[np.argmax(exact - counts)] += 1
    while counts.sum() > total:
        counts[np.argmax(counts)] -= 1
    return [int(count) for count in counts]
