"""A checkpoint at work outside of lerobot-eval acts as the policy does, and remembers what was really done."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from lerobot_adamanip.collection.trained_policy import TrainedPolicy, policy_hash
from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError

MakeTiny = Callable[..., tuple[Any, ...]]


@pytest.fixture
def saved(make_tiny: MakeTiny, tmp_path: Path) -> tuple[Path, tuple[Any, ...]]:
    made = make_tiny(preset="keyframe")
    for part in made[:3]:
        part.save_pretrained(tmp_path)
    return tmp_path, made


def observation(dataset: Any, index: int) -> dict[str, np.ndarray]:
    """What an environment would have shown at a row, the last step of its windows."""
    item = dataset[index]
    shapes = {"point_cloud": (schema.POINT_CLOUD, 2), "agent_pos": (schema.STATE, 1), "effort": (schema.EFFORT, 1)}
    return {name: item[key].reshape(-1, *item[key].shape[-axes:])[-1].numpy() for name, (key, axes) in shapes.items()}


def test_it_acts_as_the_policy_does(saved: tuple[Path, tuple[Any, ...]], observation_of: Any) -> None:
    path, (policy, before, after, dataset) = saved
    actor = TrainedPolicy(path)
    actor.reset(5)
    found = [actor.act(observation(dataset, index), "open the safe") for index in range(3)]
    torch.manual_seed(5)
    policy.eval().reset()
    for index in range(3):
        with torch.inference_mode():
            wanted = after(policy.select_action(observation_of(dataset, before, index)))
        assert found[index].shape == (schema.ACTION_DIM,)
        np.testing.assert_allclose(found[index], wanted[0], atol=1e-6)


def test_an_episode_does_not_remember_the_one_before(make_tiny: MakeTiny, tmp_path: Path) -> None:
    """A worker may have run any other episode before."""
    *parts, dataset = make_tiny(preset="keyframe", memory_episodes=3)
    for part in parts:
        part.save_pretrained(tmp_path)
    actor = TrainedPolicy(tmp_path)
    for seed in range(2):
        actor.reset(seed)
        assert not actor._policy.executed_history(1, torch.zeros(1))[1].any()
        actor.act(observation(dataset, 0), "open the safe")


def test_what_was_really_done_is_what_is_remembered(saved: tuple[Path, tuple[Any, ...]]) -> None:
    path, (*_, after, dataset) = saved
    actor = TrainedPolicy(path)
    actor.reset(0)
    actor.act(observation(dataset, 0), "open the safe")
    done = dataset[1][schema.ACTION].reshape(-1, schema.ACTION_DIM)[-1].numpy()
    actor.executed(done)
    history, valid = actor._policy.executed_history(1, torch.zeros(1))
    assert valid.sum() == 1
    np.testing.assert_allclose(after(history[:, -1])[0], done, atol=1e-5)


def test_a_hash_tells_policies_apart(saved: tuple[Path, tuple[Any, ...]]) -> None:
    path, _ = saved
    with pytest.raises(ConfigurationError, match="No policy is there"):
        policy_hash(path / "none")
    known = {policy_hash(path), policy_hash(path)}
    (states,) = path.glob("policy_preprocessor*normalizer*.safetensors")
    for file in ("config.json", "policy_postprocessor.json", states.name):
        content = (path / file).read_bytes()
        (path / file).write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
        known.add(policy_hash(path))
    assert len(known) == 4  # statistics decide how it acts, too
    (path / "train_config.json").write_text("{}")
    assert policy_hash(path) in known
