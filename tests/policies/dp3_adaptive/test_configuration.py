"""Presets of ``dp3_adaptive``, and its configuration in checkpoints; see also `test_config.py`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_policy_adamanip import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.presets import PRESETS

PAPER = {
    "num_points": 4096, "encoder": "pointnet2", "n_action_history_steps": 4, "horizon": 4, "n_action_steps": 2,
    "noise_scheduler_type": "DDPM", "num_train_timesteps": 100, "num_inference_steps": 100,
    "optimizer_lr": 1e-4, "optimizer_weight_decay": 1e-6,
}  # fmt: skip


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_fills_what_was_left_open_and_nothing_else(preset: str) -> None:
    given: dict[str, Any] = {"num_points": 77, "optimizer_lr": 3e-3, "n_action_history_steps": 0}
    config = DP3AdaptiveConfig(preset=preset, device="cpu", **given)
    assert PRESETS["fast"].keys() == PRESETS[preset].keys()
    for name, value in PRESETS[preset].items():
        assert getattr(config, name) == given.get(name, value), name


def test_presets_have_the_numbers_of_the_paper_and_of_dp3s_release() -> None:
    paper = DP3AdaptiveConfig(preset="paper", device="cpu")
    assert {name: getattr(paper, name) for name in PAPER} == PAPER
    dp3 = DP3AdaptiveConfig(preset="dp3", device="cpu")
    assert (dp3.n_obs_steps, dp3.horizon, dp3.n_action_steps, dp3.n_action_history_steps) == (2, 4, 3, 0)
    assert (dp3.observation_delta_indices, dp3.action_delta_indices) == ([-1, 0], None)
    assert DP3AdaptiveConfig(preset="diffusion", device="cpu").observation_delta_indices is None


@pytest.mark.parametrize("preset", PRESETS)
def test_a_saved_configuration_comes_back_whole(tmp_path: Path, preset: str) -> None:
    options: dict[str, Any] = {
        "head": "diffusion",
        "horizon": 8,
        "encoder_dims": (8, 16),
        "optimizer_betas": (0.8, 0.9),
    }
    config = DP3AdaptiveConfig(preset=preset, num_points=77, use_effort=True, device="cpu", tags=["a"], **options)
    shapes = {schema.POINT_CLOUD: (77, 3), schema.STATE: (24,), schema.EFFORT: (7,)}
    config.input_features = {key: PolicyFeature(FeatureType.STATE, shape) for key, shape in shapes.items()}
    config.output_features = {schema.ACTION: PolicyFeature(FeatureType.ACTION, (10,))}
    config.validate_features()
    assert config.input_features.keys() == shapes.keys()
    config.save_pretrained(tmp_path)
    loaded = PreTrainedConfig.from_pretrained(tmp_path)
    assert isinstance(loaded, DP3AdaptiveConfig)
    assert loaded == config
    changed = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--num_inference_steps=7"])
    assert (changed.num_inference_steps, changed.num_points) == (7, 77)
    other = next(name for name in PRESETS if name != preset)
    with pytest.raises(AdaManipError, match=rf"(?s)checkpoint's preset cannot be changed.*preset={other}"):
        PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=[f"--preset={other}"])


def test_tool_frames_are_refused_where_they_cannot_be_computed() -> None:
    mapping = dict.fromkeys(("STATE", "ACTION"), NormalizationMode.MEAN_STD)
    options: dict[str, Any] = {"preset": "diffusion", "device": "cpu", "normalization_mapping": mapping}
    with pytest.raises(AdaManipError, match="tcp_relative"):
        DP3AdaptiveConfig(**options)
    assert DP3AdaptiveConfig(**options, tcp_relative=False).tcp_relative is False
