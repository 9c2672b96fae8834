"""`adamanip merge`: combine several datasets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_adamanip.contract.pointcloud import Workspace
from lerobot_adamanip.contract.versions import mixed_versions
from lerobot_adamanip.datasets.compose import Pieces, Progress, compose
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.output_folder import WRITING, owned_output
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.datasets.selection import Selection
from lerobot_adamanip.util import files
from lerobot_adamanip.util.errors import ConfigurationError, DatasetError
from lerobot_adamanip.util.json_fields import parse


@dataclass(frozen=True)
class Merged:
    """Result of a merge."""

    episodes: int
    parts_of_one: bool
    """Whether the sources are parts of one dataset; the episodes then have its order."""
    whole: bool
    """Whether they are all of its parts."""
    mixed_versions: str
    """Versions of the software that differ between episodes; empty if none do."""


def merge(
    roots: Sequence[Path],
    out: Path,
    *,
    repo_id: str | None = None,
    progress: Progress = lambda done, total: None,
) -> Merged:
    """Writes one dataset with all episodes of several.

    Rows, images and columns of episodes are copied; tasks, indices and statistics are recomputed. ``out`` appears when
    it is complete. Parts of one dataset (`adamanip filter`, `adamanip split`) come in that dataset's order, so all its
    parts together restore it. Other datasets follow one another in the order of ``roots``, without the manifests and
    attempts of their collections.

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
    _require_equal_features(sources)
    one_workspace(sources)
    _require_each_once(sources)
    pieces, selection = _in_order(sources)
    compose(folder, pieces, repo_id, selection, progress)
    whole = selection is not None and selection.is_whole
    columns = [source.own_columns for source in sources if "versions" in source.own_columns.column_names]
    texts = {value for each in columns for value in each["versions"].to_pylist()}
    texts.discard(None)  # of episodes that a robot recorded
    return Merged(len(pieces), selection is not None, whole, mixed_versions(map(parse, texts)))


def _in_order(sources: Sequence[Dataset]) -> tuple[Pieces, Selection | None]:
    """Returns the episodes in their new order, and the dataset that they are all a part of, if any."""
    pieces = [(source, episode) for source in sources for episode in range(len(source))]
    if len({(each.selection.source, each.selection.source_episodes) for each in sources}) > 1:
        return pieces, None
    known = [index for source in sources for index in source.selection.episodes]
    order = sorted(range(len(known)), key=known.__getitem__)
    first = sources[0].selection
    selection = Selection(first.source, first.source_episodes, tuple(sorted(known)))
    return [pieces[place] for place in order], selection


def _require_each_once(sources: Sequence[Dataset]) -> None:
    """Raises `DatasetError` if two sources hold the same episode."""
    known = Counter((each.selection.source, index) for each in sources for index in each.selection.episodes)
    if twice := sorted(index for (_, index), count in known.items() if count > 1):
        raise DatasetError(
            "These datasets share episodes, which would appear twice in the new one.",
            got=f"{len(twice)} of them: {', '.join(map(str, twice[:5]))} (indices in their source dataset)",
            allowed="datasets, or parts of one, without a common episode",
            hint="name each dataset once; for overlapping parts, use one `adamanip filter` that selects both",
        )


def _require_equal_features(sources: Sequence[Dataset]) -> None:
    first = _features(sources[0].info)
    for source in sources[1:]:
        features = _features(source.info)
        if differing := sorted(key for key in {**first, **features} if first.get(key) != features.get(key)):
            raise DatasetError(
                "Datasets with different features cannot be merged.",
                got=f"{source.root.name} has {', '.join(differing[:3])} unlike {sources[0].root.name}",
                allowed="the same columns with the same shapes",
                hint="`adamanip keyframes` for recordings, `adamanip render` for pictures; the same --num-points",
            )


def _features(info: dict[str, Any]) -> dict[str, Any]:
    """Returns types and shapes of the features, and the frame rate; other descriptions may differ."""
    kinds = {key: (feature["dtype"], tuple(feature["shape"])) for key, feature in info["features"].items()}
    return {**kinds, "fps": info["fps"]}


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
