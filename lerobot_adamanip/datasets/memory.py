"""`adamanip memory`: a copy of a dataset with the memory of felt tries, as a column or in the tasks."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import DENSE, KEYFRAME, STATES
from lerobot_adamanip.contract.memory import (
    EVENTS,
    MEMORY,
    NO_MEMORY,
    TEXT,
    check_memory,
    instruction_of,
    memory_feature,
)
from lerobot_adamanip.datasets.cards import dataset_card
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.compose import Addition, Column, compose
from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.dense import is_dense_collection, kind_by_size
from lerobot_adamanip.datasets.output_folder import WRITING, owned_output
from lerobot_adamanip.datasets.repository_names import require_repo_id
from lerobot_adamanip.episode.memory import Memory, stored_memory
from lerobot_adamanip.hardware.features import is_dense
from lerobot_adamanip.util import files
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import read


def add_memory(
    root: Path,
    out: Path,
    form: str,
    *,
    assets: str | Path | None = None,
    repo_id: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Writes a copy of a dataset with a memory; returns the number of episodes.

    Rows, pictures and columns of episodes stay unchanged. The copy equals a dataset collected with this memory.

    Args:
        root: folder of a dataset, or of a robot's recording.
        out: folder of the new dataset, which must not exist.
        form: ``events`` or ``text``, see `contract.memory.MEMORIES`.
        assets: folder of external assets, if the dataset was recorded with any; for its card.
        repo_id: ``local/<folder name>`` by default.
        progress: called after each episode.

    Raises:
        DatasetError: the dataset is damaged or has a memory already, or ``out`` exists.
        ConfigurationError: its actions are no tool poses.
    """
    require_repo_id(repo_id)
    with owned_output(out, WRITING) as output:
        output.require_free()
        source = Dataset(root, recordings=True)
        addition = _addition(source, form)
        if manifest_path(source.root).is_file():
            source.manifest(assets)  # an error before the work, which the card would raise after it
        output.require_room(files.tree_bytes(source.root))
        built, name = output.fresh("dataset"), repo_id or f"local/{output.root.name}"
        pieces = [(source, episode) for episode in range(len(source))]
        compose(built, pieces, name, source.selection, progress, addition=addition)
        if manifest_path(source.root).is_file():
            content: Any = read(manifest_path(source.root))
            content["collection"]["environment"]["memory"] = form
            files.write_atomically(
                manifest_path(built), (json.dumps(content, indent=2, sort_keys=True) + "\n").encode()
            )
        if (source.root / "README.md").is_file() and not is_dense(source.features):
            (built / "README.md").write_text(dataset_card(built, output.root.name, name, assets))
        output.publish(built)
    return len(source)


def _addition(source: Dataset, form: str) -> Addition:
    """Returns the memory's column, or its changed tasks; raises `DatasetError` if the dataset cannot have it."""
    features = source.features
    states = [(len(names),) for names in STATES.values()]
    has_memory = source.memory != NO_MEMORY
    if has_memory or tuple(features[schema.STATE]["shape"]) not in states:
        got = "a memory already" if has_memory else f"{schema.STATE} of shape {features[schema.STATE]['shape']}"
        raise DatasetError(
            "No memory can be added to this dataset.",
            got=f"{source.root.name} has {got}",
            allowed="a dataset without one, whose states are those of `adamanip collect` or of the robot",
            hint="the dataset it was made of",
        )
    control = DENSE if is_dense_collection(features) or is_dense(features) else KEYFRAME
    action = kind_by_size(features, schema.ACTION)
    check_memory(form, control=control, action=action)
    memory = Memory(control=control, action=action, fps=source.fps)
    sent = schema.EXECUTED if schema.EXECUTED in features else schema.ACTION

    def compute(table: pa.Table, tasks: list[str]) -> tuple[dict[str, Column], list[str]]:
        rows = list(stored_memory(_floats(table, schema.STATE), _floats(table, sent), memory))
        if form == TEXT:
            return {}, [instruction_of(task) + sentence for task, (_, sentence) in zip(tasks, rows, strict=True)]
        return {MEMORY: np.stack([numbers for numbers, _ in rows])}, tasks

    return Addition({MEMORY: memory_feature()} if form == EVENTS else {}, compute)


def _floats(table: pa.Table, key: str) -> NDArray[np.float32]:
    """Returns a column (T, D); raises `DatasetError` if its rows differ in length."""
    values = numeric_array(table[key])
    if values is None:
        raise DatasetError("A column has rows of different lengths.", got=key, allowed="one length for all")
    return values.astype(np.float32)
