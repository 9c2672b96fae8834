"""What holds for each policy's configuration, and its optimizer."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import torch
from draccus.wrappers.docstring import get_attribute_docstring, get_preferred_help_text
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.optim.optimizers import AdamWConfig, OptimizerConfig, load_optimizer_state, save_optimizer_state
from lerobot.policies.factory import get_policy_class
from toy_demos import TINY

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import AdaManipError
from lerobot_policy_adamanip import AdaAffordConfig, DP3AdaptiveConfig, SamplingConfig, VatMartConfig
from lerobot_policy_adamanip.common.config import FusedAdamWConfig
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import OPTIONS, PRESETS, TRAIN_TIMESTEPS, Inference

Refuses = Callable[[type[AdaManipError], Callable[[], Any]], str]
CONFIGS: tuple[Any, ...] = (VatMartConfig, SamplingConfig, AdaAffordConfig, DP3AdaptiveConfig)
AFFORDANCE = ("vat_mart", "sampling", "adaafford")
every_method = pytest.mark.parametrize("method", [*AFFORDANCE, "dp3_adaptive"])
DP3_TINY: dict[str, Any] = {
    "num_points": 120, "encoder_dims": (16,), "preset": "keyframe", "device": "cpu", "push_to_hub": False,
}  # fmt: skip
WRONG_UNET: list[dict[str, Any]] = [
    {"horizon": 3}, {"horizon": 0}, {"n_action_steps": 17}, {"down_dims": (32,) * 6}, {"down_dims": (30, 64)},
    {"down_dims": ()}, {"num_inference_steps": 101}, {"num_inference_steps": 0}, {"noise_scheduler_type": "nonsense"},
]  # fmt: skip
WRONG: dict[str, list[dict[str, Any]]] = {
    "affordance": [
        {"num_points": 0}, {"feature_dim": 0}, {"patch_radius": 0.0}, {"encoder_dims": ()}, {"context_points": 121},
        {"n_obs_steps": 2}, {"encoder_dims": (16, 0)},
    ],
    "sampling": [{"likely_share": 1.5}, {"likely_share": 0.0}, {"encoder_dims": (-1,)}],
    "dp3_adaptive": [
        {"encoder_dims": (16, -3)}, {"encoder_out_dim": 0},
        {"horizon": 2}, {"n_obs_steps": 2}, {"num_anchors": 0}, {"num_points": 0}, {"encoder_dims": ()},
        {"num_refinements": -1}, {"inference": Inference(memory=False), "preset": "dp3"},
        {"inference": Inference(temperature=0.0)}, {"inference": Inference(latest_events=-1)},
        {"n_action_history_steps": -1}, {"n_action_steps": 0}, {"augmentation_mirror": 1.5},
        {"augmentation_earlier_episodes": -0.1}, {"augmentation_earlier_episodes": 0.5, "preset": "dense"},
        {"n_obs_steps": 2, "preset": "keyframe"}, {"preset": "nonsense"}, {"use_feedback": "false"},
        {"num_points": "64"}, {"optimizer_lr": "small"}, {"inference": Inference(memory="false")},  # type: ignore[arg-type]
        *({"memory_episodes": 3, "preset": preset} for preset in ("dense", "dp3", "paper")),
        {"memory_episodes": 3, "n_action_history_steps": 0},
        {"inference": Inference(no_repeat=True), "n_action_history_steps": 0},
        *({**wrong, "preset": preset} for preset in ("dense", "dp3") for wrong in WRONG_UNET),
    ],
}  # fmt: skip
WRONG_FEATURES: list[tuple[dict[str, Any], str]] = [
    ({"points": (64, 3)}, "120 points"), ({"points": (160, 2)}, "120 points"), ({"points": (190,)}, "120 points"),
    ({"action": 7}, "tool poses"), ({"missing": schema.POINT_CLOUD}, schema.POINT_CLOUD),
    ({"missing": schema.STATE}, schema.STATE),
]  # fmt: skip

PAPER = {
    "num_points": 4096, "n_action_history_steps": 4, "horizon": 4, "n_action_steps": 2,
    "noise_scheduler_type": "DDPM", "num_inference_steps": 100, "optimizer_lr": 1e-4,
}  # fmt: skip


def features(points: tuple[int, ...] = (160, 3), action: int = 10, missing: str | None = None) -> dict[str, Any]:
    inputs = {
        schema.POINT_CLOUD: PolicyFeature(FeatureType.STATE, points),
        schema.STATE: PolicyFeature(FeatureType.STATE, (24,)),
        schema.FRONT_IMAGE: PolicyFeature(FeatureType.VISUAL, (3, 32, 32)),
    }
    return {
        "input_features": {key: value for key, value in inputs.items() if key != missing},
        "output_features": {schema.ACTION: PolicyFeature(FeatureType.ACTION, (action,))},
    }


def config_of(method: str, **changes: Any) -> Any:
    options = DP3_TINY if method == "dp3_adaptive" else TINY
    return PreTrainedConfig.get_choice_class(method)(**{**options, **changes})


@pytest.mark.parametrize("kind", CONFIGS)
def test_every_option_is_explained_and_names_its_presets(kind: Any) -> None:
    ours = {name for each in kind.__mro__ if "adamanip" in each.__module__ for name in each.__annotations__}
    for name in ours & {item.name for item in dataclasses.fields(kind)}:
        told = " ".join(get_preferred_help_text(get_attribute_docstring(kind, name)).split())
        assert told.endswith((".", "...")), name
        if kind is DP3AdaptiveConfig and name in OPTIONS:
            values = {preset: used[name] for preset, used in PRESETS.items() if name in used}
            shown = [
                f"{key} {' '.join(map(str, value)) if isinstance(value, tuple) else value}"
                for key, value in values.items()
            ]
            assert f"({', '.join(shown)})" in told


@every_method
def test_options_that_cannot_work_are_refused_at_once(refuses: Refuses, method: str) -> None:
    for wrong in WRONG.get(method, WRONG["affordance"]):
        assert next(iter(wrong)) in refuses(AdaManipError, lambda wrong=wrong: config_of(method, **wrong)), wrong


@every_method
def test_features_that_it_cannot_use_are_refused(refuses: Refuses, method: str) -> None:
    for wrong, told in WRONG_FEATURES:
        config = config_of(method, **features(**wrong))
        check = config.validate_features
        if method == "dp3_adaptive" and "action" in wrong:
            check = lambda config=config: get_policy_class(method)(config)  # noqa: E731
        message = refuses(AdaManipError, check)
        assert told in message
        assert method in message or "points" in message


@every_method
def test_it_looks_at_cloud_and_state_alone(method: str) -> None:
    config = config_of(method, **features())
    config.validate_features()
    assert config.input_features.keys() == {schema.POINT_CLOUD, schema.STATE}
    assert config.input_features[schema.POINT_CLOUD].type is FeatureType.ENV
    assert config.normalization_mapping["ENV"] is NormalizationMode.IDENTITY


@every_method
def test_ten_numbers_with_other_names_are_no_pose(method: str) -> None:
    config, named = config_of(method, **features()), schema.dataset_features(160, cameras=())
    config.set_dataset_feature_metadata(named)
    assert config.has_pose_layout
    named[schema.ACTION]["names"] = [f"joint_{index}.pos" for index in range(10)]
    config.set_dataset_feature_metadata(named)
    assert not config.has_pose_layout


@every_method
def test_without_data_or_a_cloud_there_is_one_clear_error(refuses: Refuses, method: str) -> None:
    policy = get_policy_class(method)(config_of(method, **features()))
    assert "nothing to learn from" in refuses(AdaManipError, lambda: policy.forward({}))
    seen = {schema.STATE: torch.zeros(1, 24)}
    assert schema.POINT_CLOUD in refuses(AdaManipError, lambda: policy.select_action(seen))


@pytest.mark.parametrize(("trained", "said"), [(None, "--policy.num_points=64"), ("p", "--env.num_points=120")])
def test_clouds_of_too_few_points_name_the_option_that_helps(refuses: Refuses, trained: str | None, said: str) -> None:
    """A policy that is to be trained can use fewer; a trained one cannot."""
    config = config_of("dp3_adaptive", **features(points=(64, 3)))
    config.pretrained_path = trained
    assert said in refuses(AdaManipError, config.validate_features).rpartition("try:")[2]


# Presets of ``dp3_adaptive`` ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_fills_what_was_left_open_and_nothing_else(preset: str) -> None:
    given: dict[str, Any] = {"num_points": 77, "optimizer_lr": 3e-3, "n_action_history_steps": 0}
    config = DP3AdaptiveConfig(preset=preset, device="cpu", **given)
    for name in OPTIONS:
        assert getattr(config, name) == given.get(name, PRESETS[preset].get(name)), name


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_refuses_what_it_does_not_use_and_names_one_that_does(refuses: Refuses, preset: str) -> None:
    values = {name: value for used in PRESETS.values() for name, value in used.items()}
    for name, value in [(name, values[name]) for name in OPTIONS - PRESETS[preset].keys()]:
        make = functools.partial(DP3AdaptiveConfig, device="cpu", **{name: value})
        message = refuses(AdaManipError, functools.partial(make, preset=preset))
        assert f"--policy.{name}" in message
        other = message.rpartition("--policy.preset=")[2].partition(",")[0]
        assert getattr(make(preset=other), name) == value


def test_presets_have_the_numbers_of_the_paper_and_of_dp3s_release() -> None:
    paper = DP3AdaptiveConfig(preset="paper", device="cpu")
    assert {name: getattr(paper, name) for name in PAPER} == PAPER
    assert (paper.method.encoder, paper.method.weight_decay, TRAIN_TIMESTEPS) == ("pointnet2", 1e-6, 100)
    dp3 = DP3AdaptiveConfig(preset="dp3", device="cpu")
    assert (dp3.n_obs_steps, dp3.horizon, dp3.n_action_steps, dp3.n_action_history_steps) == (2, 4, 3, 0)
    assert (dp3.observation_delta_indices, dp3.action_delta_indices) == ([-1, 0], None)
    assert DP3AdaptiveConfig(preset="keyframe", device="cpu").observation_delta_indices is None


@pytest.mark.parametrize("preset", PRESETS)
def test_a_saved_configuration_comes_back_whole(tmp_path: Path, preset: str) -> None:
    inference = Inference(memory=False) if preset == "keyframe" else Inference()
    options: dict[str, Any] = {"encoder_dims": (8, 16), "inference": inference}
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
    changed = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--encoder_out_dim=7"])
    assert (changed.encoder_out_dim, changed.num_points) == (7, 77)
    other = next(name for name in PRESETS if name != preset)
    if preset == "keyframe":
        switched = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--inference.no_repeat=true"])
        assert switched.inference == Inference(memory=False, no_repeat=True)
    with pytest.raises(AdaManipError, match=rf"(?s)checkpoint's preset cannot be changed.*preset={other}"):
        PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=[f"--preset={other}"])


# Optimizer -----------------------------------------------------------------------------------------------------------

VALUES = {"lr": 1e-2, "betas": (0.95, 0.999), "weight_decay": 1e-2}


def trained(model: torch.nn.Module, optimizer: torch.optim.Optimizer, steps: int, seed: int = 0) -> list[torch.Tensor]:
    draw = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        optimizer.zero_grad()
        model(torch.randn(16, 5, generator=draw)).square().mean().backward()
        optimizer.step()
    return [weight.detach().clone() for weight in model.parameters()]


def small_model() -> torch.nn.Module:
    torch.manual_seed(0)
    return torch.nn.Sequential(torch.nn.Linear(5, 33), torch.nn.Tanh(), torch.nn.Linear(33, 3))


def test_it_is_adamw_up_to_rounding_also_after_a_resume(tmp_path: Path) -> None:
    one = small_model()
    other = copy.deepcopy(one)
    fused, plain = FusedAdamWConfig(**VALUES).build(one.parameters()), AdamWConfig(**VALUES).build(other.parameters())
    assert fused.defaults["fused"]
    torch.testing.assert_close(trained(one, fused, 20), trained(other, plain, 20), rtol=1e-4, atol=1e-6)
    save_optimizer_state(fused, tmp_path)
    resumed = copy.deepcopy(one)
    again = load_optimizer_state(FusedAdamWConfig(**VALUES).build(resumed.parameters()), tmp_path)
    torch.testing.assert_close(trained(resumed, again, 10, 1), trained(one, fused, 10, 1), rtol=1e-5, atol=1e-7)


def test_moments_that_decay_become_zero_and_no_switch_of_the_process_is_turned() -> None:
    weights = [torch.nn.Parameter(torch.ones(4)) for _ in range(2)]
    built, plain = FusedAdamWConfig(**VALUES).build(weights[:1]), AdamWConfig(**VALUES).build(weights[1:])
    for weight, optimizer in zip(weights, (built, plain), strict=True):
        weight.grad = torch.full((4,), 1e-3)
        optimizer.step()
        weight.grad = torch.zeros(4)
        for _ in range(1_999):
            optimizer.step()
    assert torch.equal(*weights)
    assert 0 < float(plain.state[weights[1]]["exp_avg"].abs().max()) < torch.finfo(torch.float32).tiny  # denormal
    assert not built.state[weights[0]]["exp_avg"].any()
    assert float(torch.tensor(1e-39) * 1.0) > 0


def test_groups_devices_without_the_kernel_and_lerobots_registry_are_served() -> None:
    model = small_model()
    groups = [{"params": [weight], "lr": 0.1 * place} for place, weight in enumerate(model.parameters(), 1)]
    built = [group["lr"] for group in FusedAdamWConfig().build(groups).param_groups]
    assert built == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert not FusedAdamWConfig().build(model.to("meta").parameters()).defaults["fused"]
    preset = config_of("dp3_adaptive", optimizer_lr=3e-4).get_optimizer_preset()
    assert OptimizerConfig.get_choice_class(preset.type) is FusedAdamWConfig
    assert preset.lr == 3e-4
    assert asdict(preset).keys() == asdict(AdamWConfig()).keys()
