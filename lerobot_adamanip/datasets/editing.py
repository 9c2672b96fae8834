"""`adamanip filter`, `split` and `merge`: new datasets of the episodes of others.

Rows, images and columns of episodes are copied; tasks, indices and statistics are recomputed. A new dataset appears at
its folder when it is complete.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.versions import mixed_versions
from lerobot_adamanip.datasets.compose import Progress, compose
from lerobot_adamanip.datasets.conditions import as_text, choose, episode_values
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.output_folder import WRITING, owned_output
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.selection import Selection
from lerobot_adamanip.experts import EXPERT_KINDS
from lerobot_adamanip.hardware.features import ARM
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.json_fields import parse

if TYPE_CHECKING:
    from pandas import DataFrame

EPISODE = "episode_index"
_ROUNDING = 1e-6
type _Content = tuple[int, str, str, int, str]
Parts = Mapping[str, Sequence[int]]
"""Name of a part -> its episode indices, ascending."""


# Filter ---------------------------------------------------------------------------------------------------------------


def filter_episodes(
    root: Path,
    conditions: Sequence[str],
    out: Path | None,
    *,
    repo_id: str | None = None,
    progress: Progress = lambda done, total: None,
) -> list[int]:
    """Writes a dataset of the episodes that fulfil all conditions; returns their indices.

    Args:
        root: folder of a dataset.
        conditions: see `conditions.choose`; empty for all episodes.
        out: folder of the new dataset, which must not exist. None to write nothing.
        repo_id: ``local/<folder name>`` by default.
        progress: called after each episode.

    Raises:
        ConfigurationError: a condition is invalid, or no episode fulfils all of them.
        DatasetError: the dataset is missing or damaged, or something is at ``out``.
    """
    require_repo_id(repo_id)
    if out is None:
        return choose(conditions, episode_values(Dataset(root, recordings=True)))
    with owned_output(out, WRITING) as output:
        output.require_free()
        source = Dataset(root, recordings=True)
        chosen = choose(conditions, episode_values(source))
        output.require_room(files.tree_bytes(source.root) * len(chosen) // len(source))
        built, name = output.fresh("dataset"), output.root.name
        words = [word for condition in conditions for word in ("--where", condition)]
        selection = source.selection.of(chosen, ["adamanip", "filter", "DATASET", *words, "--out", name])
        compose(built, [(source, episode) for episode in chosen], repo_id or f"local/{name}", selection, progress)
        output.publish(built)
    return chosen


# Split ----------------------------------------------------------------------------------------------------------------


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
        root: folder of a dataset.
        out: folder of the parts, which must not exist.
        shares: name of a part -> its share; they add up to 1. None makes one part for each value of ``by``.
        by: column of `conditions.episode_values`. Episodes with equal values stay together; shares are of the values.
        seed: seed of the random assignment.
        progress: called after each episode.

    Raises:
        ConfigurationError: the shares do not add up to 1, the column is unknown, or there are fewer values than parts.
        DatasetError: the dataset is damaged, or ``out`` exists.
    """
    with owned_output(out, WRITING) as output:
        output.require_free()
        source = Dataset(root, recordings=True)
        parts = assign(episode_values(source), shares, by=by, seed=seed)
        output.require_room(files.tree_bytes(source.root))
        built = output.fresh("dataset")
        built.mkdir()
        words = [] if shares is None else ["--parts", ",".join(f"{name}={share:g}" for name, share in shares.items())]
        command = ["adamanip", "split", "DATASET", *words, "--by", by, "--seed", str(seed), "--out", output.root.name]
        written, total = 0, len(source)
        for name, chosen in parts.items():

            def advance(done: int, _: int, before: int = written) -> None:
                progress(before + done, total)

            pieces = [(source, episode) for episode in chosen]
            compose(built / name, pieces, f"local/{name}", source.selection.of(chosen, command), advance)
            written += len(chosen)
        files.sync(built)
        output.publish(built)
    return parts


def assign(table: DataFrame, shares: Mapping[str, float] | None, *, by: str, seed: int) -> Parts:
    """Returns the episodes of each part, see `split_episodes`; depends on its arguments only."""
    groups = _groups(table, by)
    if shares is None:
        return {_folder_name(by, value): episodes for value, episodes in groups.items()}
    _check_shares(shares, len(groups), by)
    if seed < 0:
        raise ConfigurationError("A seed is negative.", got=seed, allowed="0 or more", hint="--seed 0")
    values = [list(groups)[place] for place in np.random.default_rng(seed).permutation(len(groups))]
    parts: dict[str, list[int]] = {}
    for name, count in zip(shares, _counts(list(shares.values()), len(values)), strict=True):
        part, values = values[:count], values[count:]
        parts[name] = sorted(episode for value in part for episode in groups[value])
    return parts


def _groups(table: DataFrame, by: str) -> dict[Any, list[int]]:
    """Returns value -> its episodes, ordered by value. Numbers are texts in a column that has texts as well."""
    if by not in table or table[by].isna().any():
        known = [name for name in table.columns if table[name].notna().all()]
        raise ConfigurationError(
            "Not every episode has this column.", got=repr(by), allowed=", ".join(known), hint="--by object_id"
        )
    values = table[by].tolist()
    if any(isinstance(value, str) for value in values):
        values = [as_text(value) for value in values]
    groups: dict[Any, list[int]] = {}
    for row, value in enumerate(values):
        groups.setdefault(value, []).append(row)
    return {value: groups[value] for value in sorted(groups)}


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
    if len(shares) < 2 or min(shares.values()) <= 0 or not abs(sum(shares.values()) - 1) <= _ROUNDING:  # also of NaN
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


# Merge ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Merged:
    """Result of a merge.

    Attributes:
        episodes: number of episodes.
        parts_of_one: whether the sources are parts of one dataset; the episodes then have its order.
        whole: whether they are all of its parts.
        mixed_versions: versions of the software that differ between episodes; empty if none do.
    """

    episodes: int
    parts_of_one: bool
    whole: bool
    mixed_versions: str


def merge(
    roots: Sequence[Path],
    out: Path,
    *,
    repo_id: str | None = None,
    progress: Progress = lambda done, total: None,
) -> Merged:
    """Writes one dataset with all episodes of several.

    Parts of one dataset (`filter_episodes`, `split_episodes`) come in that dataset's order, so all its parts together
    restore it. Other datasets follow one another in the order of ``roots``, without the manifests and attempts of their
    collections.

    Args:
        roots: folders of two or more datasets with equal features.
        out: folder of the new dataset, which must not exist.
        repo_id: ``local/<folder name>`` by default.
        progress: called after each episode.

    Raises:
        DatasetError: a source is damaged or has other features, two share episodes, or ``out`` exists.
        ConfigurationError: fewer than two sources, or this version of LeRobot writes datasets differently.
    """
    if len(roots) < 2:
        raise ConfigurationError(
            "There is nothing to merge.",
            got=f"{len(roots)} dataset(s)",
            allowed="two or more",
            hint="adamanip merge ONE OTHER --out BOTH",
        )
    require_repo_id(repo_id)
    with owned_output(out, WRITING) as output:
        output.require_free()
        output.require_room(sum(map(files.tree_bytes, roots)))
        built = output.fresh("dataset")
        merged = merge_into(built, roots, repo_id or f"local/{output.root.name}", progress)
        output.publish(built)
    return merged


def merge_into(
    folder: Path, roots: Sequence[Path], repo_id: str, progress: Progress = lambda done, total: None
) -> Merged:
    """Merges like `merge`, into a new folder that belongs to the caller."""
    sources = [Dataset(root, recordings=True) for root in roots]
    for source in sources:
        _ = source.episodes  # checks their texts, before anything is written
    _require_equal_features(sources)
    one_workspace(sources)
    _require_each_once(sources)
    pieces = [(source, episode) for source in sources for episode in range(len(source))]
    selection = None
    if len({(source.selection.source, source.selection.source_episodes) for source in sources}) == 1:
        indices = [index for source in sources for index in source.selection.episodes]
        first = sources[0].selection
        selection = Selection(first.source, first.source_episodes, tuple(sorted(indices)))
        pieces = [pieces[place] for place in sorted(range(len(indices)), key=indices.__getitem__)]
    compose(folder, pieces, repo_id, selection, progress)
    columns = [source.own_columns for source in sources if "versions" in source.own_columns.column_names]
    texts = {value for column in columns for value in column["versions"].to_pylist()}
    texts.discard(None)  # of episodes that a robot recorded
    whole = selection is not None and selection.is_whole
    return Merged(len(pieces), selection is not None, whole, mixed_versions(map(parse, texts)))


def _require_each_once(sources: Sequence[Dataset]) -> None:
    """Raises `DatasetError` if two sources hold the same episode."""
    known = Counter((source.selection.source, index) for source in sources for index in source.selection.episodes)
    twice, which = sorted(index for (_, index), count in known.items() if count > 1), "indices in their source dataset"
    if not twice:
        contents: dict[str, set[_Content]] = {}
        for source in sources:
            contents.setdefault(source.selection.source, set()).update(_contents(source))
        equal = Counter(itertools.chain.from_iterable(contents.values()))
        twice, which = sorted(seed for (seed, *_), count in equal.items() if count > 1), "seeds"
    if twice:
        raise DatasetError(
            "These datasets share episodes, which would appear twice in the new one.",
            got=f"{len(twice)} of them: {', '.join(map(str, twice[:5]))} ({which})",
            allowed="datasets, or parts of one, without a common episode",
            hint="name each dataset once; for overlapping parts, use one `adamanip filter` that selects both; "
            "for rounds of corrections, another --seed in each",
        )


def _contents(source: Dataset) -> Iterator[_Content]:
    """Yields seed, object, expert, length and statistics of the actions of each simulated episode of an expert.

    Corrections of two policies in one scene are equal if the expert drove all of both.
    """
    names = ("seed", "object_id", "expert", "length")
    if not set(names) <= set(source.table.column_names):
        return
    statistics = [source.statistics[f"stats/{schema.ACTION}/{name}"].to_pylist() for name in ("min", "max", "mean")]
    columns = [source.table[name].to_pylist() for name in names]
    for seed, object_id, expert, length, *actions in zip(*columns, *statistics, strict=True):
        if expert in EXPERT_KINDS:
            yield seed, object_id, expert, length, str(actions)


def _require_equal_features(sources: Sequence[Dataset]) -> None:
    """Raises `DatasetError` if types or shapes of features, frame rates or memories differ; other descriptions may.

    Only recordings have the column `ARM`, which `compose` leaves out beside simulated demonstrations.
    """
    kinds = []
    for source in sources:
        features = {key: feature for key, feature in source.features.items() if key != ARM}
        shapes = {key: (feature["dtype"], tuple(feature["shape"])) for key, feature in features.items()}
        kinds.append({"fps": source.fps, "memory": source.memory} | shapes)
    for source, other in zip(sources[1:], kinds[1:], strict=True):
        if differing := sorted(key for key in {**kinds[0], **other} if kinds[0].get(key) != other.get(key)):
            raise DatasetError(
                "Datasets with different features cannot be merged.",
                got=f"{source.root.name} has {', '.join(differing[:3])} unlike {sources[0].root.name}",
                allowed="the same columns with the same shapes, and the same memory",
                hint="`adamanip keyframes` for recordings, `adamanip render` for pictures, `adamanip memory`;"
                " the same --num-points",
            )


def one_workspace(sources: Sequence[Dataset]) -> Workspace:
    """Returns the common workspace of all these datasets' clouds; raises `DatasetError` if they differ."""
    boxes = [source.workspace for source in sources]
    if len(set(boxes)) > 1:
        raise DatasetError(
            "The clouds of these datasets have different workspaces.",
            got="; ".join(f"{source.root.name}: {box}" for source, box in zip(sources, boxes, strict=True)),
            allowed="one workspace for all",
            hint="leave one of them out",
        )
    return boxes[0]
