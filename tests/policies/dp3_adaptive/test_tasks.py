"""One policy for several tasks: it is told what to do, and tasks count alike."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import pytest
import torch
from lerobot.processor.converters import batch_to_transition, transition_to_batch

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.categories import CATEGORIES
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.dp3_adaptive.processor_dp3_adaptive import (
    INSTRUCTION,
    INSTRUCTION_DIM,
    InstructionStep,
    instruction_vector,
)

MakeTiny = Callable[..., tuple[Any, ...]]


def test_instructions_are_told_apart_and_the_same_words_are_the_same() -> None:
    texts = [category.instruction for category in CATEGORIES.values()]
    vectors = [instruction_vector(text) for text in texts]
    assert all(vector.shape == (INSTRUCTION_DIM,) for vector in vectors)
    assert all(float(vector.norm()) == pytest.approx(1) for vector in vectors)
    assert all(float(one @ other) < 0.9 for one, other in itertools.combinations(vectors, 2))
    assert torch.equal(instruction_vector("Open the safe."), instruction_vector("open the safe"))
    assert not instruction_vector("").any()


def test_one_text_is_a_list_of_one_and_none_is_an_error() -> None:
    def told(task: Any) -> Any:
        batch = {schema.STATE: torch.zeros(1, 24), "task": task}
        return transition_to_batch(InstructionStep()(batch_to_transition(batch)))[INSTRUCTION]

    assert torch.equal(told("open the safe"), told(["open the safe"]))
    assert told(["open the safe"]).shape == (1, INSTRUCTION_DIM)
    for task in (None, [], [3]):
        with pytest.raises(ConfigurationError, match="needs an instruction"):
            told(task)


@pytest.mark.parametrize("preset", ["keyframe", "dp3"])
def test_what_it_is_told_counts_in_training_and_at_run_time_alike(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, preset: str
) -> None:
    policy, before, _, dataset = make_tiny(preset=preset, use_instruction=True)
    policy.train()
    loss, _ = policy(batch_of(dataset, before, 1, 5, 14))
    loss.backward()
    assert torch.isfinite(loss)
    policy.eval()

    def act(text: str) -> torch.Tensor:
        policy.reset()
        noise = torch.full((1, policy.config.horizon, schema.ACTION_DIM), 0.3)
        return policy.select_action(observation_of(dataset, before, 5, task=[text]), noise=noise)

    assert torch.equal(act("open the safe"), act("open the safe"))
    assert not torch.equal(act("open the safe"), act("take the cap off the bottle"))
