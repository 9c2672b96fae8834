"""Saved, loaded and fine-tuned policies, and their cards."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy

MakeTiny = Callable[..., tuple[Any, ...]]


def _trained(make_tiny: MakeTiny, batch_of: Any, **changes: Any) -> tuple[Any, ...]:
    """A policy whose averaged weights differ from the trained ones."""
    policy, before, after, dataset = make_tiny(**changes)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=1e-2)
    for _ in range(3):
        optimizer.zero_grad()
        policy.forward(batch_of(dataset, before, 0, 7))[0].backward()
        optimizer.step()
        policy.update()
    return policy, before, after, dataset


@pytest.mark.parametrize(
    "changes", [{}, {"preset": "paper"}, {"preset": "fast", "num_anchors": 6, "training_points": 24}]
)
def test_a_loaded_policy_acts_and_trains_as_the_saved_one(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, tmp_path: Path, changes: dict[str, Any]
) -> None:
    policy, before, after, dataset = _trained(make_tiny, batch_of, **changes)
    for part in (policy, before, after):
        part.save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path = tmp_path
    loaded = make_policy(config, ds_meta=dataset.meta)
    again, _ = make_pre_post_processors(config, pretrained_path=str(tmp_path))
    assert not loaded.training
    saved, found = policy.state_dict(), loaded.state_dict()
    assert saved.keys() == found.keys()
    assert all(torch.equal(saved[key], found[key]) for key in saved)
    assert int(loaded.ema_steps) == 3
    assert any(key.startswith("ema_model.") for key in saved)
    noise = torch.randn(1, policy.config.horizon, 10)
    policy.eval()
    for step in (0, 1, 2):
        actions = []
        for actor, prepare in ((policy, before), (loaded, again)):
            torch.manual_seed(4)
            actions.append(actor.select_action(observation_of(dataset, prepare, step), noise=noise))
        assert torch.equal(*actions)
    losses = []
    for actor in (policy.train(), loaded.train()):
        torch.manual_seed(4)
        losses.append(actor.forward(batch_of(dataset, before, 3))[0])
    assert torch.equal(*losses)


def test_a_checkpoint_of_other_weights_is_one_clear_error(make_tiny: MakeTiny, tmp_path: Path) -> None:
    from safetensors.torch import load_file, save_file

    make_tiny()[0].save_pretrained(tmp_path)
    settings = json.loads((tmp_path / "config.json").read_text())
    weights = load_file(tmp_path / "model.safetensors")
    for changes in ({"down_dims": (64, 64)}, {"n_action_history_steps": 2}, {"encoder": "pointnet2"}, {}):
        (tmp_path / "config.json").write_text(json.dumps({**settings, **changes}))
        if not changes:  # nor are missing weights left at random
            weights.pop(next(iter(weights)))
            save_file(weights, tmp_path / "model.safetensors")
        with pytest.raises(ConfigurationError, match=r"(?s)got:.*allowed:.*try:") as caught:
            DP3AdaptivePolicy.from_pretrained(tmp_path)
        assert str(tmp_path) in str(caught.value)
        assert len(str(caught.value)) < 1000


def test_fine_tuning_measures_poses_as_the_new_data_are_normalised(
    make_tiny: MakeTiny, batch_of: Any, tmp_path: Path
) -> None:
    """LeRobot normalises with the new data's statistics; what undoes it must use the same, or metres are none."""
    still = {"augmentation_translation": 0.0, "augmentation_yaw": 0.0}
    policy, before, after, dataset = _trained(make_tiny, batch_of, **still)
    for part in (policy, before, after):
        part.save_pretrained(tmp_path)
    other = dataset.meta
    for key in (schema.STATE, schema.ACTION):
        other.stats[key]["min"] = other.stats[key]["min"] - 0.5
        other.stats[key]["max"] = other.stats[key]["max"] + 0.1
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path = tmp_path
    tuned = make_policy(config, ds_meta=other)
    stats = {"stats": other.stats}
    # As lerobot-train does for --policy.path.
    again, _ = make_pre_post_processors(
        config,
        pretrained_path=str(tmp_path),
        preprocessor_overrides={"normalizer_processor": stats},
        postprocessor_overrides={"unnormalizer_processor": stats},
    )
    old, new = batch_of(dataset, before, 6), batch_of(dataset, again, 6)
    assert not torch.allclose(old[schema.ACTION], new[schema.ACTION], atol=1e-2)
    expected = policy.frames.to_relative(old[schema.ACTION][:, None], old[schema.STATE])
    found = tuned.frames.to_relative(new[schema.ACTION][:, None], new[schema.STATE])
    torch.testing.assert_close(found[..., :3], expected[..., :3], rtol=0, atol=1e-5)
    # The encoder keeps the units it was trained in.
    assert torch.equal(tuned.frames.cloud_center, policy.frames.cloud_center)
    assert torch.equal(tuned.frames.cloud_scale, policy.frames.cloud_scale)


def test_a_card_describes_this_policy(make_tiny: MakeTiny) -> None:
    from lerobot.configs.default import DatasetConfig
    from lerobot.configs.train import TrainPipelineConfig

    policy, *_, dataset = make_tiny(n_action_history_steps=5, repo_id="someone/opens-safes", tags=["safe"])
    policy.update()
    training = TrainPipelineConfig(dataset=DatasetConfig(repo_id="someone/safe-demos"), policy=policy.config)
    card = policy.generate_model_card(cfg=training, dataset_meta=dataset.meta)
    assert card.data.license == "apache-2.0"
    assert card.data.datasets == ["someone/safe-demos"]
    assert {"robotics", "lerobot", "dp3_adaptive", "safe"} <= set(card.data.tags)
    assert card.text.lstrip().startswith("# dp3_adaptive")
    for fact in ("someone/opens-safes", "last 5 actions", schema.POINT_CLOUD, "averaged over 1 updates"):
        assert fact in card.text
    assert "lerobot-eval --policy.path=someone/opens-safes" in card.text
