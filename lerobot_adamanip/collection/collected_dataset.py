"""Reader of a collected dataset, for rebuilding its scenes. The dataset is untrusted, so every value is checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.datasets.dataset import Dataset
from lerobot_adamanip.datasets.episode import read_start
from lerobot_adamanip.datasets.manifest import Manifest
from lerobot_adamanip.episode.rollout import SimulatedEnvironment


@dataclass(frozen=True)
class CollectedEpisode:
    """A recorded episode with T rows.

    Attributes:
        columns: dataset column -> (T, ...) array, without images.
        record: fields of `EpisodeDescription`, and ``task``.
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

    source: Dataset
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
        dataset = Dataset(root)
        return cls(dataset, dataset.manifest(assets))

    @cached_property
    def rows(self) -> list[dict[str, Any]]:
        """One metadata row per episode, as stored, without statistics."""
        return [dict(episode.row) for episode in self.source.episodes]

    def episode(self, number: int) -> CollectedEpisode:
        """Reads an episode; raises `DatasetError` for invalid values."""
        recorded = self.source.recorded(number, self.manifest)
        return CollectedEpisode(recorded.columns, recorded.record, read_start(recorded.record["start"]))
