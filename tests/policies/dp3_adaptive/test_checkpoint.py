"""Saved, loaded and fine-tuned policies, and their cards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors

from lerobot_adamanip.contract import schema

MakeTiny = Callable[..., tuple[Any, ...]]


def test_fine_tuning_measures_poses_as_the_new_data_are_normalised(
    make_tiny: MakeTiny, batch_of: Any, tmp_path: Path
) -> None:
    """LeRobot normalises with the new data's statistics; what undoes it must use the same, or metres are none."""
    still = {"augmentation_translation": 0.0, "augmentation_yaw": 0.0}
    policy, before, after, dataset = make_tiny(**still)
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
