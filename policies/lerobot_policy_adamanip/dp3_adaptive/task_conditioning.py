"""Several tasks in one policy: instructions as vectors, and weights that balance tasks."""

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
    """Returns a unit vector (64,) by feature hashing (Weinberger et al. 2009) of words and pairs of words."""
    words = re.findall(r"\w+", text.lower())
    vector = torch.zeros(INSTRUCTION_DIM)
    for token in (*words, *(f"{one} {other}" for one, other in itertools.pairwise(words))):
        number = int.from_bytes(hashlib.blake2b(token.encode(), digest_size=8).digest(), "big")
        vector[number % INSTRUCTION_DIM] += 1.0 if number >> 63 else -1.0
    unit: Tensor = vector / vector.norm().clamp(min=1e-6)
    return unit


def balanced_weights(dataset_meta: Any) -> Tensor:
    """Returns a row's weight by its task's index, inverse to the task's number of rows; the mean over rows is 1."""
    rows: Counter[int] = Counter()
    for tasks, length in zip(dataset_meta.episodes["tasks"], dataset_meta.episodes["length"], strict=True):
        rows[int(dataset_meta.get_task_index(tasks[0]))] += int(length)
    mean = sum(rows.values()) / len(rows)
    return torch.tensor([mean / rows[index] if rows[index] else 0.0 for index in range(1 + max(rows))])
