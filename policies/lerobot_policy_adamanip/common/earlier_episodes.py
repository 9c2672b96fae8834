"""Training of a memory that is kept over episodes: histories that begin in another episode.

At run time ``memory_episodes`` keeps the history while one scene is played again. No demonstration shows that. So in
training some histories are continued into the past, by another episode with the same hidden values, ranges aside. A
run ends when the part opens, so the other episode is used up to the command that opened it. Rows up to the last failed
try of the present episode are then not labels: a policy that remembers the other one should not make that try.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from lerobot_adamanip.catalog import category_of
from lerobot_adamanip.contract.schema import FAILED, SUCCESS
from lerobot_adamanip.util.arrow import episode_bounds
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.inputs import EPISODE, INDEX, is_trained, read_columns

EARLIER = 2
"""Number of other episodes in which a history is continued, if the first is short."""


class EarlierEpisodes:
    """Episodes with the same hidden values, among those that are trained on.

    Args:
        dataset_meta: metadata of key frames, with their files.
        share: share of the histories that are continued, 0 to 1.
        steps: length of the histories.

    Raises:
        ConfigurationError: the data lack hidden values, or the outcomes of tries and episodes; or ``steps`` is 0.
    """

    def __init__(self, dataset_meta: Any, share: float, steps: int) -> None:
        if not steps:
            raise ConfigurationError(
                "A policy without a history of actions remembers no episode.",
                got=f"augmentation_earlier_episodes={share:g} with n_action_history_steps=0",
                allowed="augmentation_earlier_episodes=0, or a history",
                hint="--policy.augmentation_earlier_episodes=0",
            )
        self.share = share
        columns = read_columns(dataset_meta, (INDEX, EPISODE, FAILED, SUCCESS))
        episode, failed, success = (columns[key].reshape(-1) for key in (EPISODE, FAILED, SUCCESS))
        first, last = episode_bounds(episode)
        failures = np.cumsum(failed > 0)
        starts = np.flatnonzero(is_trained(dataset_meta, episode) & (first == np.arange(len(first))))
        of_starts = [dataset_meta.episodes[int(episode[row])] for row in starts]
        names = np.array([_hidden_values(each) for each in of_starts])
        order = np.argsort(names, kind="stable")
        starts, begun = starts[order], np.array([bool(each.get("late")) for each in of_starts])[order]
        _, begin, count = np.unique(np.sort(names), return_index=True, return_counts=True)
        places = np.zeros((len(first), 3), np.int64)
        for offset, size in zip(begin, count, strict=True):
            for rank, row in enumerate(starts[offset : offset + size]):
                # No episode of a run starts amid the task, so histories of those that do are not continued.
                places[row : last[row] + 1] = offset, 1 if begun[offset + rank] else size, rank
        # Of a run, the command that succeeds is the last one. The last row is a final observation, without a command.
        succeeded = np.append(np.flatnonzero(success > 0), len(last))
        end = np.minimum(succeeded[np.searchsorted(succeeded, np.arange(len(last)))] + 1, last)
        arrays = {
            "end": end, "places": places, "starts": starts,
            "fails": failures[last] - failures + (failed > 0) > 0,
        }  # fmt: skip
        self._tensors = {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in arrays.items()}

    def continued(self, present: Tensor, rows: Tensor, valid: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Continues histories of present rows (B,) in random other episodes with the same hidden values.

        A full history stays as it is, one without such an episode, and one of an episode that starts amid the task.

        Args:
            present: positions (B,) of rows.
            rows: positions (B, H) before them, oldest first.
            valid: whether these are of the same episode (B, H).

        Returns:
            ``rows`` and ``valid`` of the longer history; whether a row is the last command of another episode (B, H);
            whether the present row's action is a training label (B,).
        """
        # Kept on the device of the batches, so that they are copied once.
        of = self._tensors = {name: values.to(present.device) for name, values in self._tensors.items()}
        offset, size, rank = of["places"][present].unbind(dim=-1)
        chosen = (torch.rand(len(present), device=present.device) < self.share) & (size > 1) & ~valid.all(dim=1)
        is_last, others = torch.zeros_like(valid), (size - 1).clamp(min=1)
        for _ in range(EARLIER):
            which = (torch.rand(len(present), device=present.device) * others).long()
            place = offset + (rank + 1 + which) % size.clamp(min=1)
            other = of["starts"][place.clamp(max=len(of["starts"]) - 1)]
            missing = (~valid).sum(dim=1, keepdim=True)
            earlier = of["end"][other, None] - missing + torch.arange(valid.shape[1], device=present.device)
            taken = chosen[:, None] & ~valid & (earlier >= other[:, None])
            is_last = is_last | (taken & (earlier == of["end"][other, None] - 1))
            rows, valid = torch.where(taken, earlier, rows), valid | taken
        return rows, valid, is_last, ~(chosen & of["fails"][present])


def _hidden_values(episode: Mapping[str, Any]) -> str:
    """Returns the category and hidden values of an episode's metadata as a text, without ranges."""
    try:
        hidden = json.loads(episode["hidden_state"])
        values = {name: value for name, value in hidden.items() if not isinstance(value, float)}
        return json.dumps([category_of(episode["object_id"]), values], sort_keys=True)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigurationError(
            "The demonstrations do not say what was hidden in an episode.",
            got=f"no hidden_state in an episode's metadata ({error})",
            allowed="simulated demonstrations",
            hint="--policy.augmentation_earlier_episodes=0",
        ) from error
