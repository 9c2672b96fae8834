"""`filter` and `split`: parts of a dataset, which are datasets themselves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from lerobot_adamanip.datasets.editing.compose import Progress, compose
from lerobot_adamanip.datasets.editing.conditions import Facts, choose
from lerobot_adamanip.datasets.editing.episode_facts import episode_facts
from lerobot_adamanip.datasets.editing.source import Source
from lerobot_adamanip.datasets.output_folder import WRITING, owned_output
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError

EPISODE = "episode_index"
_SUM = 1e-6
Parts = Mapping[str, Sequence[int]]
"""Name -> indices of its episodes, ascending."""


def filter_episodes(
    root: Path,
    conditions: Sequence[str],
    out: Path | None,
    *,
    repo_id: str | None = None,
    progress: Progress = lambda done, total: None,
) -> list[int]:
    """Writes a dataset with the episodes that fulfil every condition; returns their indices.

    Rows, pictures, statistics of poses and the columns of episodes stay as they are; indices begin at 0 again. Half of
    a dataset is never at ``out``.

    Args:
        root: of a dataset.
        conditions: see `parse_condition`; none for all episodes.
        out: of the new one; a folder that does not exist. None to write nothing.
        repo_id: ``local/<folder name>`` by default.
        progress: told of episodes done, and all.

    Raises:
        ConfigurationError: a condition names no column, or compares it with what it cannot be, or none is fulfilled.
        DatasetError: the dataset is missing or damaged, or something is at ``out``.
    """
    require_repo_id(repo_id)
    if out is None:
        return choose(conditions, episode_facts(Source.open(root)))
    with owned_output(out, WRITING) as output:
        output.require_free()
        source = Source.open(root)
        chosen = choose(conditions, episode_facts(source))
        output.require_room(files.tree_bytes(source.root) * len(chosen) // source.info["total_episodes"])
        built = output.fresh("dataset")
        name = output.root.name
        words = [word for condition in conditions for word in ("--where", condition)]
        command = ["adamanip", "filter", "DATASET", *words, "--out", name]
        _write(source, {name: chosen}, {name: (built, command)}, repo_id, progress)
        output.publish(built)
    return chosen


def split_episodes(
    root: Path,
    out: Path,
    shares: Mapping[str, float] | None,
    *,
    by: str = EPISODE,
    seed: int = 0,
    progress: Progress = lambda done, total: None,
) -> Parts:
    """Writes every episode of a dataset into one of several; returns who got which.

    Args:
        root: of a dataset.
        out: folder of the new ones; one that does not exist.
        shares: name of a part -> its share; 1 together. None for a part for each value of ``by``.
        by: name of a column, see `episode_facts`: episodes of one value stay together. Shares are of its values.
        seed: of the drawing of lots.
        progress: told of episodes done, and all.

    Raises:
        ConfigurationError: shares that are none, an unknown column, or fewer values than parts.
        DatasetError: the dataset is missing or damaged, or something is at ``out``.
    """
    with owned_output(out, WRITING) as output:
        output.require_free()
        source = Source.open(root)
        parts = assign(episode_facts(source), shares, by=by, seed=seed)
        output.require_room(files.tree_bytes(source.root))
        built = output.fresh("dataset")
        built.mkdir()
        said = [] if shares is None else ["--parts", ",".join(f"{name}={share:g}" for name, share in shares.items())]
        command = ["adamanip", "split", "DATASET", *said, "--by", by, "--seed", str(seed), "--out", output.root.name]
        _write(source, parts, {name: (built / name, command) for name in parts}, None, progress)
        files.sync(built)
        output.publish(built)
    return parts


def assign(facts: Sequence[Facts], shares: Mapping[str, float] | None, *, by: str, seed: int) -> Parts:
    """Returns who gets which episodes: see `split_episodes`. Depends on nothing but the arguments."""
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


def _write(
    source: Source,
    parts: Parts,
    places: Mapping[str, tuple[Path, Sequence[str]]],
    repo_id: str | None,
    progress: Progress,
) -> None:
    """Writes parts into their folders, each with the command that chose it."""
    total, before = sum(map(len, parts.values())), 0
    for name, chosen in parts.items():
        folder, command = places[name]
        pieces, selection = [(source, episode) for episode in chosen], source.selection.of(list(chosen), command)
        compose(folder, pieces, repo_id or f"local/{name}", selection, _after(progress, before, total))
        before += len(chosen)


def _after(progress: Progress, before: int, total: int) -> Callable[[int, int], None]:
    return lambda done, _: progress(before + done, total)


def _groups(facts: Sequence[Facts], by: str) -> dict[object, list[int]]:
    """Returns value -> its episodes, in an order of the values that does not depend on that of the episodes."""
    found: dict[object, list[int]] = {}
    for number, each in enumerate(facts):
        found.setdefault(each.get(by), []).append(number)
    if None in found:
        known = [name for name in facts[0] if all(each.get(name) is not None for each in facts)]
        raise ConfigurationError(
            "Not every episode has such a column.", got=repr(by), allowed=", ".join(known), hint="--by object_id"
        )
    return {value: found[value] for value in sorted(found)}  # type: ignore[type-var]


def _folder_name(by: str, value: object) -> str:
    text = str(value).lower() if isinstance(value, bool) else str(value)
    if not text or len(text) > 100 or not all(letter.isalnum() or letter in "_-." for letter in text) or text[0] == ".":
        raise ConfigurationError(
            "A value cannot be the name of a folder.",
            got=f"{by} = {text[:100]!r}",
            allowed="letters, digits, _, - and .",
            hint="--parts train=0.8,validation=0.2",
        )
    return text


def _check_shares(shares: Mapping[str, float], groups: int, by: str) -> None:
    if len(shares) < 2 or min(shares.values()) <= 0 or abs(sum(shares.values()) - 1) > _SUM:
        raise ConfigurationError(
            "These are no parts of a whole.",
            got=", ".join(f"{name}={share:g}" for name, share in shares.items()),
            allowed="two or more shares above 0 that make 1 together",
            hint="--parts train=0.8,validation=0.2",
        )
    if groups < len(shares):
        raise ConfigurationError(
            "There is not enough to part.",
            got=f"{groups} different {by} for {len(shares)} parts",
            allowed="as many as parts, or more",
            hint="fewer parts, or without --by",
        )


def _counts(shares: Sequence[float], total: int) -> list[int]:
    """Returns how many of ``total`` each share gets: largest remainders, and at least one each."""
    exact = [share * total for share in shares]
    counts = [max(1, int(each + _SUM)) for each in exact]
    while sum(counts) < total:
        missing = [each - count for each, count in zip(exact, counts, strict=True)]
        counts[missing.index(max(missing))] += 1
    while sum(counts) > total:
        counts[counts.index(max(counts))] -= 1
    return counts
