"""`adamanip filter`: a dataset of the episodes that fulfil conditions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lerobot_adamanip.datasets.compose import Progress, compose
from lerobot_adamanip.datasets.conditions import choose
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.episode_facts import episode_facts
from lerobot_adamanip.datasets.output_folder import WRITING, owned_output
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.util import files


def filter_episodes(
    root: Path,
    conditions: Sequence[str],
    out: Path | None,
    *,
    repo_id: str | None = None,
    progress: Progress = lambda done, total: None,
) -> list[int]:
    """Writes a dataset of the episodes that fulfil all conditions; returns their indices.

    Rows, images and columns of episodes are copied; indices restart at 0. ``out`` appears when it is complete.

    Args:
        root: of a dataset.
        conditions: see `conditions.parse_condition`; empty for all episodes.
        out: folder of the new dataset, which must not exist. None to write nothing.
        repo_id: ``local/<folder name>`` by default.
        progress: called after each episode.

    Raises:
        ConfigurationError: a condition is invalid, or no episode fulfils all of them.
        DatasetError: the dataset is missing or damaged, or something is at ``out``.
    """
    require_repo_id(repo_id)
    if out is None:
        return choose(conditions, episode_facts(Dataset(root, recordings=True)))
    with owned_output(out, WRITING) as output:
        output.require_free()
        source = Dataset(root, recordings=True)
        chosen = choose(conditions, episode_facts(source))
        output.require_room(files.tree_bytes(source.root) * len(chosen) // len(source))
        built, name = output.fresh("dataset"), output.root.name
        words = [word for condition in conditions for word in ("--where", condition)]
        selection = source.selection.of(chosen, ["adamanip", "filter", "DATASET", *words, "--out", name])
        pieces = [(source, episode) for episode in chosen]
        compose(built, pieces, repo_id or f"local/{name}", selection, progress)
        output.publish(built)
    return chosen
