"""Saved, loaded and fine-tuned policies, and their cards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_policy_adamanip.dp3_adaptive.modeling_dp3_adaptive import DP3AdaptivePolicy

MakeTiny = Callable[..., tuple[Any, ...]]


def test_fine_tuning_keeps_the_units_of_clouds_and_takes_those_of_the_new_data(
    make_tiny: MakeTiny, batch_of: Any, tmp_path: Path
) -> None:
    """LeRobot normalises with the new data's statistics; the encoder sees clouds in the units it was trained in."""
    policy, before, after, dataset = make_tiny()
    units, cloud = policy.model.cloud_units, as_points(dataset[6][schema.POINT_CLOUD])
    assert 0.5 < units(cloud).abs().max() <= 1.0
    torch.testing.assert_close(units(cloud).diff(dim=0) * units.scale, cloud.diff(dim=0), rtol=0, atol=1e-5)
    for part in (policy, before, after):
        part.save_pretrained(tmp_path)
    other = dataset.meta
    for key in (schema.STATE, schema.ACTION, schema.POINT_CLOUD):
        other.stats[key]["min"] = other.stats[key]["min"] - 0.5
        other.stats[key]["max"] = other.stats[key]["max"] + 0.1
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path = tmp_path
    tuned = make_policy(config, ds_meta=other)
    stats = {"stats": other.stats}
    # As lerobot-train does for --policy.path.
    again, back = make_pre_post_processors(
        config,
        pretrained_path=str(tmp_path),
        preprocessor_overrides={"normalizer_processor": stats},
        postprocessor_overrides={"unnormalizer_processor": stats},
    )
    old, new = batch_of(dataset, before, 6), batch_of(dataset, again, 6)
    assert not torch.allclose(old[schema.ACTION], new[schema.ACTION], atol=1e-2)
    labels = tuned.training_window(new)[1][:, 0]
    torch.testing.assert_close(back(labels), dataset[6][schema.ACTION][None], rtol=0, atol=1e-5)
    assert torch.equal(tuned.model.cloud_units.center, units.center)
    assert torch.equal(tuned.model.cloud_units.scale, units.scale)


def test_a_checkpoint_can_be_used_without_its_memory(make_tiny: MakeTiny, batch_of: Any, tmp_path: Path) -> None:
    policy, before, _, dataset = make_tiny(preset="keyframe", n_action_history_steps=4)
    policy.save_pretrained(tmp_path)
    plain = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--n_action_history_steps=0"])
    loaded = DP3AdaptivePolicy.from_pretrained(tmp_path, config=plain)
    window, *_ = policy.training_window(batch_of(dataset, before))
    assert policy.model.past(window).contact.any()
    assert loaded.model.memory is None
    for model in (policy.model, policy.ema_model):
        model.memory = None
    found = [each.model.eval()(window)[:2] for each in (policy, loaded)]
    assert all(torch.equal(*pair) for pair in zip(*found, strict=True))


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
