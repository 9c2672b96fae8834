"""Reader of a collected dataset, for rebuilding its scenes. The dataset is untrusted, so every value is checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract import schema
from lerobot_adamanip.datasets.collection_spec import manifest_path
from lerobot_adamanip.datasets.manifest import HIDDEN_STATE, Manifest, read_manifest
from lerobot_adamanip.datasets.reading import JSON_COLUMNS, load_check
from lerobot_adamanip.datasets.source import Source
from lerobot_adamanip.datasets.start_column import read_start
from lerobot_adamanip.episode.rollout import SimulatedEnvironment
from lerobot_adamanip.util.arrow import numeric_array
from lerobot_adamanip.util.errors import DatasetError
from lerobot_adamanip.util.json_fields import flag, integer, optional, parse, text

_TEXT = text(r"(?s).*", "text")


@dataclass(frozen=True)
class CollectedEpisode:
    """A recorded episode with T rows.

    Attributes:
        columns: dataset column -> (T, ...) array, without images.
        record: episode metadata, see `JSON_COLUMNS` for parsed columns.
        prefix: (n, 10) actions between the reset and its first row.
    """

    columns: dict[str, NDArray[Any]]
    record: dict[str, Any]
    prefix: NDArray[np.float32]

    def reset(self, env: SimulatedEnvironment) -> Any:
        """Starts the scene of this episode, at rest; returns the first observation."""
        options = {"object_id": self.record["object_id"]}
        if self.record["hidden_overrides"] is not None:
            options["hidden_overrides"] = self.record["hidden_overrides"]
        return env.reset(seed=self.record["seed"], options=options)[0]


@dataclass(frozen=True)
class CollectedDataset:
    """A dataset of `adamanip collect`: its rows and its manifest."""

    source: Source
    manifest: Manifest

    @classmethod
    def open(cls, root: Path, assets: str | Path | None) -> CollectedDataset:
        """Opens a dataset.

        Args:
            root: folder of the dataset.
            assets: folder of external assets, if the dataset uses any.

        Raises:
            DatasetError: it is missing, incomplete, damaged, or of another kind.
        """
        return cls(Source(root, load_check(root)), read_manifest(manifest_path(root), assets))

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """One metadata row per episode, as stored, without statistics."""
        return [self.source.row(number) for number in range(self.source.info["total_episodes"])]

    def episode(self, number: int) -> CollectedEpisode:
        """Reads an episode; raises `DatasetError` for invalid values."""
        row = self.rows[number]
        try:
            table = self.source.rows(row)
            record = self._record(row)
            record["task"] = self.source.tasks[table["task_index"][0].as_py()]
            return CollectedEpisode(self._columns(table), record, read_start(row["start"]))
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise DatasetError(
                "An episode of the dataset has invalid values.",
                got=f"episode {number} of {self.source.root}: {error}",
                allowed="rows as `adamanip collect` writes them",
                hint=f"another episode; what is damaged: adamanip check {self.source.root.name}",
            ) from error

    def _record(self, row: dict[str, Any]) -> dict[str, Any]:
        record = {**row, **{name: parse(_TEXT(name, row[name])) for name in JSON_COLUMNS}}
        if record["object_id"] not in self.manifest.spec.objects:
            raise ValueError("object_id is none of the collection's")
        integer(0, 2**63 - 1)("seed", record["seed"])
        integer(2, 10_000)("length", record["length"])
        flag("success", record["success"])
        optional(HIDDEN_STATE)("hidden_overrides", record["hidden_overrides"])
        return record

    def _columns(self, table: Any) -> dict[str, NDArray[Any]]:
        features = schema.dataset_features(self.manifest.spec.environment.num_points, cameras=())
        columns = {}
        for key, feature in features.items():
            values = numeric_array(table[key])
            if values is None:
                raise ValueError(f"{key} has missing values")
            columns[key] = values.astype(feature["dtype"], copy=False).reshape(len(table), *feature["shape"])
        return columns
