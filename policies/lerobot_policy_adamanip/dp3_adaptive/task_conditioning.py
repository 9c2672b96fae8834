"""Several tasks in one policy: what is to be done, in words, as numbers; and how much a row of each counts."""

from __future__ import annotations

import functools
import hashlib
import itertools
import re
from collections import Counter
from typing import Any

import torch
from torch import Tensor

INSTRUCTION = "observation.instruction"
INSTRUCTION_DIM = 64


@functools.cache
def instruction_vector(text: str) -> Tensor:
    """Returns (64,): each word, and each pair of neighbours, adds one or takes one off at a place that its hash says.

    Feature hashing (Weinberger et al. 2009), of length one: nothing is downloaded. What the numbers mean is learnt
    behind them.
    """
    words = re.findall(r"\w+", text.lower())
    vector = torch.zeros(INSTRUCTION_DIM)
    for token in (*words, *(f"{one} {other}" for one, other in itertools.pairwise(words))):
        number = int.from_bytes(hashlib.blake2b(token.encode(), digest_size=8).digest(), "big")
        vector[number % INSTRUCTION_DIM] += 1.0 if number >> 63 else -1.0
    unit: Tensor = vector / vector.norm().clamp(min=1e-6)
    return unit


def balanced_weights(dataset_meta: Any) -> Tensor:
    """Returns a weight per task (by its index) that makes up for how many rows a dataset has of it; of all rows, 1."""
    rows: Counter[int] = Counter()
    for tasks, length in zip(dataset_meta.episodes["tasks"], dataset_meta.episodes["length"], strict=True):
        rows[int(dataset_meta.get_task_index(tasks[0]))] += int(length)
    mean = sum(rows.values()) / len(rows)
    return torch.tensor([mean / rows[index] if rows[index] else 0.0 for index in range(1 + max(rows))])
