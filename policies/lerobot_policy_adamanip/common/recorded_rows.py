"""Narrow columns of a dataset, looked up by the ``index`` of a training batch.

LeRobot's readers give windows of labels, but not of what was executed, and of no column outside of observations and
actions. So these policies ask LeRobot for the present row alone, and look up what came before and comes after.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_adamanip.util.arrow import episode_bounds
from lerobot_adamanip.util.errors import ConfigurationError

INDEX, EPISODE = "index", "episode_index"
_PLACE, _FIRST, _LAST = "place of an index", "first row of the episode", "last row of the episode"


class RecordedRows:
    """Rows of a dataset's narrow columns. A batch needs nothing but its ``index``, whatever read it.

    Tensors are copied to the device of the first look-up from there. They are no part of a checkpoint.

    Args:
        columns: key -> (R, ...), in order of the row's ``index``; `INDEX` and `EPISODE` among them. A dataset of which
            some episodes were downloaded has the rows of those.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        index, episode = (columns[key].reshape(-1) for key in (INDEX, EPISODE))
        place = np.full(int(index.max(initial=-1)) + 2, -1, np.int64)
        place[index] = np.arange(len(index))
        first, last = episode_bounds(episode)
        read = {**columns, _PLACE: place, _FIRST: first, _LAST: last}
        arrays = {key: torch.from_numpy(np.array(values)) for key, values in read.items()}
        self._tensors = {torch.device("cpu"): arrays}

    def rows(self, index: Tensor) -> Tensor:
        """Returns the places (B,) of rows by their ``index`` (B,) or (B, 1).

        Raises:
            ConfigurationError: a row is none of those that were read; on a GPU it is not looked at, for it would wait.
        """
        index = index.reshape(-1)
        place = self._on(index.device)[_PLACE]
        rows = place[index.clamp(max=len(place) - 1)]
        if rows.device.type == "cpu" and (rows < 0).any():
            raise ConfigurationError(
                "A batch holds rows that the policy does not know.",
                got=f"index {int(index[rows < 0][0])} of a dataset of {int((place >= 0).sum())} rows",
                allowed="batches of the dataset that the policy was made with",
                hint="make_policy(config, ds_meta=dataset.meta)",
            )
        return rows

    def column(self, key: str, rows: Tensor) -> Tensor:
        """Returns a column (..., D) at rows (...), as `rows` and `around` give them."""
        return self._on(rows.device)[key][rows]

    def around(self, rows: Tensor, steps: Sequence[int]) -> tuple[Tensor, Tensor]:
        """Returns rows (B, T) that lie so many steps from others (B,), and whether their episodes have them (B, T).

        A row beyond an end of its episode is that end, as in LeRobot's windows.
        """
        tensors = self._on(rows.device)
        wanted = rows[:, None] + torch.as_tensor(steps, dtype=rows.dtype, device=rows.device)
        first, last = (tensors[key][rows, None] for key in (_FIRST, _LAST))
        return wanted.clamp(first, last), (wanted >= first) & (wanted <= last)

    def _on(self, device: torch.device) -> dict[str, Tensor]:
        if device not in self._tensors:
            known = next(iter(self._tensors.values()))
            self._tensors[device] = {key: value.to(device) for key, value in known.items()}
        return self._tensors[device]
