"""What holds for each of the point-level policies: checkpoints and actions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors
from toy_demos import observed, toy_world

from lerobot_adamanip.util.errors import ConfigurationError

MakePolicy = Callable[..., tuple[Any, ...]]
every_method = pytest.mark.parametrize("method", ["vat_mart", "sampling", "adaafford"])


@every_method
def test_a_checkpoint_acts_through_lerobots_factories(
    method: str, make_toy_policy: MakePolicy, adaptive_toy_root: Path, batch_of: Any, tmp_path: Path
) -> None:
    policy, before, after, dataset = make_toy_policy(method, adaptive_toy_root)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-2)
    policy.forward(batch_of(dataset, before))[0].backward()
    optimizer.step()
    for part in (policy, before, after):
        part.save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path = tmp_path
    loaded = make_policy(config, ds_meta=dataset.meta)
    again = make_pre_post_processors(config, pretrained_path=str(tmp_path))
    saved, found = policy.state_dict(), loaded.state_dict()
    assert saved.keys() == found.keys()
    assert not any(key.startswith("_labels") for key in saved)
    assert all(torch.equal(saved[key], found[key]) for key in saved)
    loaded.forward(batch_of(dataset, again[0]))  # it can be trained on
    actions = []
    for actor, (first, last) in ((policy, (before, after)), (loaded, again)):
        actor.eval()
        actor.reset()
        torch.manual_seed(4)
        observation = first(observed(toy_world("bottle_000", 1), np.random.default_rng(0)))
        actions.append(last(actor.select_action(observation)))
    assert actions[0].shape == (1, 10)
    assert torch.equal(*actions)
    settings = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**settings, "feature_dim": 16}))
    with pytest.raises(ConfigurationError, match="does not fit"):
        type(policy).from_pretrained(tmp_path)


@every_method
def test_actions_are_poses(method: str, make_toy_policy: MakePolicy, adaptive_toy_root: Path) -> None:
    policy, *_ = make_toy_policy(method, adaptive_toy_root)
    policy.eval()
    observation = observed(toy_world("bottle_000", 1), np.random.default_rng(0))
    for _ in range(6):
        action = policy.select_action(observation)[0]
        rows = action[3:9].reshape(2, 3)
        torch.testing.assert_close(rows @ rows.T, torch.eye(2))
        assert 0 <= action[9] <= 1


@every_method
def test_every_weight_learns_also_where_no_row_counts(
    method: str, make_toy_policy: MakePolicy, adaptive_toy_root: Path, batch_of: Any
) -> None:
    policy, before, _, dataset = make_toy_policy(method, adaptive_toy_root)
    for rows in ([], [len(dataset) - 1]):
        loss, metrics = policy.forward(batch_of(dataset, before, *rows))
        assert torch.isfinite(loss)
        assert all(isinstance(value, float) for value in metrics.values())
        policy.zero_grad()
        loss.backward()
        named = dict(policy.model.named_parameters())
        assert [name for name, weight in named.items() if weight.grad is None] == []
        still = [name for name, weight in named.items() if not weight.grad.any()]
        assert still == (list(named) if rows else [])
