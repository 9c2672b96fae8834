from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from draccus.wrappers.docstring import get_attribute_docstring, get_preferred_help_text
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_policy_adamanip import DP3AdaptiveConfig
from lerobot_policy_adamanip.dp3_adaptive.presets import PRESETS

Refuses = Callable[[type[AdaManipError], Callable[[], Any]], str]
PAPER = {
    "num_points": 4096, "encoder": "pointnet2", "n_action_history_steps": 4, "horizon": 4, "n_action_steps": 2,
    "noise_scheduler_type": "DDPM", "num_train_timesteps": 100, "num_inference_steps": 100,
    "optimizer_lr": 1e-4, "optimizer_weight_decay": 1e-6,
}  # fmt: skip


def _features(points: tuple[int, ...] = (64, 3)) -> dict[str, PolicyFeature]:
    return {
        schema.POINT_CLOUD: PolicyFeature(FeatureType.STATE, points),
        schema.STATE: PolicyFeature(FeatureType.STATE, (24,)),
        schema.EFFORT: PolicyFeature(FeatureType.STATE, (7,)),
        schema.FRONT_IMAGE: PolicyFeature(FeatureType.VISUAL, (3, 32, 32)),
    }


def test_the_papers_preset_has_the_papers_numbers() -> None:
    config = DP3AdaptiveConfig(preset="paper", device="cpu")
    assert {name: getattr(config, name) for name in PAPER} == PAPER
    assert config.get_optimizer_preset().lr == 1e-4
    assert config.get_optimizer_preset().weight_decay == 1e-6


def test_dp3_has_the_numbers_of_its_release_and_sees_no_past_action() -> None:
    config = DP3AdaptiveConfig(preset="dp3", device="cpu")
    assert (config.n_obs_steps, config.horizon, config.n_action_steps) == (2, 4, 3)
    assert config.n_action_history_steps == 0
    assert config.observation_delta_indices == [-1, 0]


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_fills_what_was_left_open_and_nothing_else(preset: str) -> None:
    given = {"num_points": 77, "optimizer_lr": 3e-3, "augmentation_yaw": 0.5, "n_action_history_steps": 0}
    config = DP3AdaptiveConfig(preset=preset, device="cpu", **given)  # type: ignore[arg-type]
    for name, value in PRESETS[preset].items():
        assert getattr(config, name) == given.get(name, value), name


@pytest.mark.parametrize("preset", PRESETS)
def test_all_presets_set_the_same_options(preset: str) -> None:
    assert PRESETS["fast"].keys() == PRESETS[preset].keys()


@pytest.mark.parametrize("preset", PRESETS)
def test_a_saved_configuration_comes_back_whole(tmp_path: Path, preset: str) -> None:
    config = DP3AdaptiveConfig(
        preset=preset,
        head="diffusion",
        horizon=8,
        num_points=77,
        encoder_dims=(8, 16),
        use_effort=True,
        device="cpu",
        history_noise_std=0.0,
        optimizer_betas=(0.8, 0.9),
        tags=["a"],
        push_to_hub=False,
        n_obs_steps=3,
    )
    config.input_features, config.output_features = (
        _features((77, 3)),
        {schema.ACTION: PolicyFeature(FeatureType.ACTION, (10,))},
    )
    config.validate_features()
    config.save_pretrained(tmp_path)
    loaded = PreTrainedConfig.from_pretrained(tmp_path)
    assert isinstance(loaded, DP3AdaptiveConfig)
    assert loaded == config
    assert loaded.encoder_dims == (8, 16)
    changed = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--num_inference_steps=7"])
    assert changed.num_inference_steps == 7
    assert changed.num_points == 77


def test_a_checkpoints_preset_cannot_be_relabelled(tmp_path: Path) -> None:
    DP3AdaptiveConfig(preset="fast", device="cpu", push_to_hub=False).save_pretrained(tmp_path)
    same = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--preset=fast"])
    assert (same.preset, same.values_from) == ("fast", "fast")
    with pytest.raises(AdaManipError, match=r"(?s)checkpoint's preset cannot be changed.*preset=paper"):
        PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--preset=paper"])


@pytest.mark.parametrize("name", [item.name for item in dataclasses.fields(DP3AdaptiveConfig)])
def test_the_help_of_every_option_is_true(name: str) -> None:
    told = get_preferred_help_text(get_attribute_docstring(DP3AdaptiveConfig, name))
    if name not in DP3AdaptiveConfig.__annotations__:
        return  # LeRobot's own
    assert told
    assert "type: ignore" not in told
    assert told.strip().endswith((".", "..."))
    if name in PRESETS["fast"]:
        values = {preset: PRESETS[preset][name] for preset in PRESETS}
        shown = [
            f"{preset} {' '.join(map(str, value)) if isinstance(value, tuple) else value}"
            for preset, value in values.items()
        ]
        assert f"({', '.join(shown)})" in " ".join(told.split())


def test_lerobot_is_asked_for_the_present_row_alone(make_config: Callable[..., Any]) -> None:
    config = make_config(n_action_history_steps=3, horizon=4)
    assert (config.observation_delta_indices, config.action_delta_indices) == (None, None)
    assert make_config(n_obs_steps=2).observation_delta_indices == [-1, 0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"horizon": 3},
        {"horizon": 0},
        {"horizon": 4, "n_action_steps": 5},
        {"n_action_steps": 0},
        {"n_obs_steps": 0},
        {"n_action_history_steps": -1},
        {"horizon": 4, "down_dims": (32, 32, 64, 64)},
    ],
)
def test_horizons_that_do_not_fit_are_refused(
    refuses: Refuses, make_config: Callable[..., Any], wrong: dict[str, Any]
) -> None:
    assert "horizon" in refuses(AdaManipError, lambda: make_config(**wrong))


@pytest.mark.parametrize(
    "wrong",
    [
        {"kernel_size": 4},
        {"down_dims": ()},
        {"down_dims": (30, 64)},
        {"num_points": 0},
        {"encoder_dims": ()},
        {"num_inference_steps": 11},
        {"num_inference_steps": 0},
    ],
)
def test_sizes_that_cannot_work_are_refused_at_once(
    refuses: Refuses, make_config: Callable[..., Any], wrong: dict[str, Any]
) -> None:
    assert next(iter(wrong)) in refuses(AdaManipError, lambda: make_config(**wrong))


@pytest.mark.parametrize("name", ["preset", "encoder", "proprioception", "noise_scheduler_type", "prediction_type"])
def test_unknown_choices_are_refused(refuses: Refuses, make_config: Callable[..., Any], name: str) -> None:
    assert "nonsense" in refuses(AdaManipError, lambda: make_config(**{name: "nonsense"}))


def test_tool_frames_are_refused_where_they_cannot_be_computed(
    refuses: Refuses, make_config: Callable[..., Any]
) -> None:
    mapping = {"STATE": NormalizationMode.MEAN_STD, "ENV": NormalizationMode.IDENTITY,
               "ACTION": NormalizationMode.MIN_MAX}  # fmt: skip
    assert "tcp_relative" in refuses(
        AdaManipError, lambda: make_config(normalization_mapping=mapping, tcp_relative=True)
    )
    assert make_config(normalization_mapping=mapping, tcp_relative=False).tcp_relative is False


def test_the_cloud_is_left_unnormalised_and_images_are_not_looked_at(make_config: Callable[..., Any]) -> None:
    config = make_config(input_features=_features())
    config.validate_features()
    assert config.input_features.keys() == {schema.POINT_CLOUD, schema.STATE}
    assert config.input_features[schema.POINT_CLOUD].type is FeatureType.ENV
    assert config.normalization_mapping["ENV"] is NormalizationMode.IDENTITY
    with_effort = make_config(input_features=_features(), use_effort=True)
    with_effort.validate_features()
    assert with_effort.input_features.keys() == {schema.POINT_CLOUD, schema.STATE, schema.EFFORT}


@pytest.mark.parametrize("missing", [schema.POINT_CLOUD, schema.STATE, schema.EFFORT])
def test_a_missing_input_is_named(refuses: Refuses, make_config: Callable[..., Any], missing: str) -> None:
    features = _features()
    del features[missing]
    assert missing in refuses(AdaManipError, make_config(input_features=features, use_effort=True).validate_features)


@pytest.mark.parametrize("shape", [(31, 3), (64, 2), (93,), (190,)])
def test_clouds_that_are_too_small_are_refused(
    refuses: Refuses, make_config: Callable[..., Any], shape: tuple[int, ...]
) -> None:
    assert "32" in refuses(AdaManipError, make_config(input_features=_features(shape)).validate_features)


def test_ten_numbers_with_other_names_are_no_pose(make_config: Callable[..., Any]) -> None:
    config = make_config(
        input_features=_features(), output_features={schema.ACTION: PolicyFeature(FeatureType.ACTION, (10,))}
    )
    features = schema.dataset_features(64, 32)
    config.set_dataset_feature_metadata(features)
    assert config.has_pose_layout
    features[schema.ACTION]["names"] = [f"joint_{index}.pos" for index in range(10)]
    config.set_dataset_feature_metadata(features)
    assert not config.has_pose_layout
