"""What holds for each of the point-level policies: configuration, checkpoints, bad input."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from draccus.wrappers.docstring import get_attribute_docstring, get_preferred_help_text
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.factory import get_policy_class, make_policy, make_pre_post_processors
from toy_demos import TINY, observed, toy_world

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError
from lerobot_policy_adamanip import AdaAffordConfig, SamplingConfig, VatMartConfig
from lerobot_policy_adamanip.affordance.config import AffordanceConfig

MakePolicy = Callable[..., tuple[Any, ...]]
Refuses = Callable[[type[AdaManipError], Callable[[], Any]], str]
CONFIGS: tuple[type[AffordanceConfig], ...] = (VatMartConfig, SamplingConfig, AdaAffordConfig)
every_method = pytest.mark.parametrize("method", [config.get_choice_name(config) for config in CONFIGS])


def features(points: tuple[int, ...] = (160, 3), action: int = 10) -> dict[str, dict[str, PolicyFeature]]:
    return {
        "input_features": {
            schema.POINT_CLOUD: PolicyFeature(FeatureType.STATE, points),
            schema.STATE: PolicyFeature(FeatureType.STATE, (24,)),
            schema.FRONT_IMAGE: PolicyFeature(FeatureType.VISUAL, (3, 32, 32)),
        },
        "output_features": {schema.ACTION: PolicyFeature(FeatureType.ACTION, (action,))},
    }


def config_of(method: str, **changes: Any) -> Any:
    return PreTrainedConfig.get_choice_class(method)(**{**TINY, **changes})


@pytest.mark.parametrize(("kind", "name"), [(kind, item.name) for kind in CONFIGS for item in dataclasses.fields(kind)])
def test_every_option_is_explained(kind: type[AffordanceConfig], name: str) -> None:
    if name not in {**AffordanceConfig.__annotations__, **kind.__annotations__}:
        return  # LeRobot's own
    told = get_preferred_help_text(get_attribute_docstring(kind, name))
    assert told
    assert told.strip().endswith((".", "..."))


@every_method
@pytest.mark.parametrize(
    "wrong",
    [
        {"num_points": 0},
        {"feature_dim": 0},
        {"patch_radius": 0.0},
        {"encoder_dims": ()},
        {"context_points": 121},
        {"n_obs_steps": 2},
    ],
)
def test_sizes_that_cannot_work_are_refused_at_once(refuses: Refuses, method: str, wrong: dict[str, Any]) -> None:
    assert next(iter(wrong)) in refuses(AdaManipError, lambda: config_of(method, **wrong))


@every_method
def test_numbers_stay_in_metres(refuses: Refuses, method: str) -> None:
    assert set(config_of(method).normalization_mapping.values()) == {NormalizationMode.IDENTITY}
    mapping = {"STATE": NormalizationMode.MIN_MAX, "ACTION": NormalizationMode.IDENTITY}
    assert "IDENTITY" in refuses(AdaManipError, lambda: config_of(method, normalization_mapping=mapping))


@every_method
def test_it_looks_at_cloud_and_state_alone(method: str) -> None:
    config = config_of(method, **features())
    config.validate_features()
    assert config.input_features.keys() == {schema.POINT_CLOUD, schema.STATE}
    assert config.input_features[schema.POINT_CLOUD].type is FeatureType.ENV


@every_method
@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"points": (64, 3)}, "120 points"),
        ({"points": (160, 2)}, "120 points"),
        ({"action": 7}, "no poses"),
    ],
)
def test_features_that_it_cannot_use_are_refused(
    refuses: Refuses, method: str, wrong: dict[str, Any], told: str
) -> None:
    assert told in refuses(AdaManipError, config_of(method, **features(**wrong)).validate_features)


@every_method
@pytest.mark.parametrize("missing", [schema.POINT_CLOUD, schema.STATE])
def test_a_missing_input_is_named(refuses: Refuses, method: str, missing: str) -> None:
    given = features()
    del given["input_features"][missing]
    message = refuses(AdaManipError, config_of(method, **given).validate_features)
    assert missing in message
    assert method in message


@every_method
def test_ten_numbers_with_other_names_are_no_pose(refuses: Refuses, method: str) -> None:
    config, named = config_of(method, **features()), schema.dataset_features(160, images=False)
    config.set_dataset_feature_metadata(named)
    config.validate_features()
    named[schema.ACTION]["names"] = [f"joint_{index}.pos" for index in range(10)]
    config.set_dataset_feature_metadata(named)
    assert "no poses" in refuses(AdaManipError, config.validate_features)


@every_method
def test_without_data_there_is_nothing_to_train(refuses: Refuses, method: str) -> None:
    policy = get_policy_class(method)(config_of(method, **features()))
    assert "nothing to learn from" in refuses(AdaManipError, lambda: policy.forward({}))


@every_method
def test_an_observation_without_a_cloud_is_one_clear_error(refuses: Refuses, method: str) -> None:
    policy = get_policy_class(method)(config_of(method, **features()))
    assert schema.POINT_CLOUD in refuses(
        AdaManipError, lambda: policy.select_action({schema.STATE: torch.zeros(1, 24)})
    )


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


@every_method
def test_a_checkpoint_of_other_sizes_is_one_clear_error(
    method: str, make_toy_policy: MakePolicy, adaptive_toy_root: Path, tmp_path: Path
) -> None:
    policy, *_ = make_toy_policy(method, adaptive_toy_root)
    policy.save_pretrained(tmp_path)
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
        first, second = action[3:6], action[6:9]
        torch.testing.assert_close(
            torch.stack([first @ first, second @ second, first @ second]), torch.tensor([1.0, 1, 0])
        )
        assert 0 <= action[9] <= 1
