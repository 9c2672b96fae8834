"""Several tasks in one policy: what is to be done, in words, as numbers; and how much a row of each counts."""

from __future__ import annotations

import functools
import hashlib
import itertools
import re
from collections import Counter
from dataclasses import dataclass
from typing import Any, cast

import torch
from lerobot.configs.types import PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import ProcessorStep, ProcessorStepRegistry
from torch import Tensor

from lerobot_adamanip.errors import ConfigurationError

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


@ProcessorStepRegistry.register("adamanip_instruction")
@dataclass
class InstructionStep(ProcessorStep):
    """Adds the instruction as `instruction_vector` to the observation, (B, 64)."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Returns a transition with it; raises `ConfigurationError` if nobody says what is to be done."""
        told = (transition.get(TransitionKey.COMPLEMENTARY_DATA) or {}).get("task")
        texts = [told] if isinstance(told, str) else list(told or ())
        if not texts or not all(isinstance(text, str) for text in texts):
            raise ConfigurationError(
                "This policy is told what to do, and nobody told it.",
                got=f"task {told!r}",
                allowed="an instruction for each observation of the batch",
                hint="a batch with a list of texts under `task`, as LeRobot's datasets and lerobot-eval give it",
            )
        vectors = torch.stack([instruction_vector(text) for text in texts])
        observation = {**(transition.get(TransitionKey.OBSERVATION) or {}), INSTRUCTION: vectors}
        return cast(EnvTransition, {**transition, TransitionKey.OBSERVATION: observation})

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """Features of the dataset stay as they are."""
        return features


def balanced_weights(dataset_meta: Any) -> Tensor:
    """Returns a weight per task (by its index) that makes up for how many rows a dataset has of it; of all rows, 1."""
    rows: Counter[int] = Counter()
    for tasks, length in zip(dataset_meta.episodes["tasks"], dataset_meta.episodes["length"], strict=True):
        rows[int(dataset_meta.get_task_index(tasks[0]))] += int(length)
    mean = sum(rows.values()) / len(rows)
    return torch.tensor([mean / rows[index] if rows[index] else 0.0 for index in range(1 + max(rows))])
