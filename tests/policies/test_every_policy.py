"""What holds for each of the policies: training, checkpoints and actions."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors
from safetensors.torch import load_file, save_file
from toy_demos import observed, toy_world, trained

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError

MakePolicy = Callable[..., tuple[Any, ...]]
AFFORDANCE = ("vat_mart", "sampling", "adaafford")
VARIANTS: dict[str, list[dict[str, Any]]] = {
    "keyframe": [
        {}, {"num_refinements": 0}, {"n_action_history_steps": 0, "num_inference_steps": 3}, {"use_effort": True},
    ],
    "dp3": [
        {}, {"n_obs_steps": 2, "horizon": 8, "n_action_steps": 3, "use_effort": True},
        {"n_action_history_steps": 0, "noise_scheduler_type": "DDPM"},
    ],
    "paper": [{}],
}  # fmt: skip
EVERY = [*((name, {}) for name in AFFORDANCE), *((name, each) for name, found in VARIANTS.items() for each in found)]
every_variant = pytest.mark.parametrize(("method", "changes"), EVERY, ids=str)
every_affordance = pytest.mark.parametrize("method", AFFORDANCE)


@pytest.fixture
def make(make_toy_policy: MakePolicy, adaptive_toy_root: Path) -> MakePolicy:
    """Builds a policy by its type, or a ``dp3_adaptive`` by its preset."""

    def build(method: str, **changes: Any) -> tuple[Any, ...]:
        if method in VARIANTS:
            return make_toy_policy("dp3_adaptive", adaptive_toy_root, preset=method, **changes)
        return make_toy_policy(method, adaptive_toy_root, **changes)

    return build


@every_variant
def test_every_weight_learns(make: MakePolicy, batch_of: Any, method: str, changes: dict[str, Any]) -> None:
    policy, before, _, dataset = make(method, **changes)
    batch = batch_of(dataset, before)
    if method == "keyframe":
        trained(policy, batch, 1)  # before, a memory says nothing, so only its last layer has a gradient
        policy.train().zero_grad()
    loss, metrics = policy.forward(batch)
    assert torch.isfinite(loss)
    assert all(isinstance(value, float) for value in (metrics or {}).values())
    loss.backward()
    still = [name for name, weight in policy.model.named_parameters() if weight.grad is None or not weight.grad.any()]
    assert not still
    if method not in AFFORDANCE:
        assert all(weight.grad is None for weight in policy.ema_model.parameters())


@pytest.mark.parametrize("method", [*AFFORDANCE, *VARIANTS])
def test_the_mean_of_the_losses_of_samples_is_the_loss(make: MakePolicy, batch_of: Any, method: str) -> None:
    """LeRobot's `--sample_weighting` weights them."""
    policy, before, _, dataset = make(method)
    batch = batch_of(dataset, before)
    results = []
    for reduction in ("mean", "none"):
        torch.manual_seed(1)
        results.append(policy.forward(dict(batch), reduction=reduction)[0])
    loss, each = results
    assert each.shape == (len(dataset),)
    assert each[-1] == 0  # the final observation has no label
    torch.testing.assert_close(each.mean(), loss, rtol=1e-4, atol=1e-6)
    each.mean().backward()
    with pytest.raises(ConfigurationError, match="Unknown reduction"):
        policy.forward(dict(batch), reduction="sum")


SEEN = ("patch_radius=0.02", "patch_points=8", "context_points=32", "num_points=64")
OF_TRAINING = ("optimizer_lr=0.1", "scheduler_warmup_steps=7", "use_amp=true", "repo_id=someone/policy")
CHANGES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "vat_mart": (SEEN, ("proposals=3", "training_proposals=3", "grasp_weight=1")),
    "sampling": (SEEN, ("likely_share=0.1",)),
    "adaafford": ((*SEEN, "num_interactions=3"), ("held_proposals=3", "explorations=0", "num_astray=1")),
    "keyframe": (
        (
            *("memory_kind=window", "use_feedback=false", "refinement_points=8", "coarse_points=16", "num_points=40"),
            *("n_action_history_steps=1", "depth_camera=wrist", "workspace_lower=[0,0,0]"),
        ),
        (
            *("n_action_history_steps=0", "inference.no_repeat=true", "inference.memory=false", "memory_episodes=3"),
            *("num_inference_steps=1", "num_refinements=1", "augmentation_mirror=0.5", "training_points=8"),
            "augmentation_earlier_episodes=0.5",
            "num_refinements=0",
        ),
    ),
    "dp3": (
        ("pose_layout=false", "control_fps=5", "num_points=16"),
        ("noise_scheduler_type=DDPM", "num_inference_steps=1", "n_action_steps=2"),
    ),
}
"""Policy -> options that change what its weights see or mean, and options that do not."""


@pytest.mark.parametrize("method", CHANGES)
def test_what_weights_have_seen_in_training_cannot_be_changed(make: MakePolicy, tmp_path: Path, method: str) -> None:
    policy, *_ = make(method)
    policy.save_pretrained(tmp_path)
    refused, accepted = CHANGES[method]
    for change in (*refused, *accepted, *OF_TRAINING):
        config, name = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=[f"--{change}"]), change.split("=")[0]
        if change in refused:
            with pytest.raises(ConfigurationError, match=rf"(?s)with another {name}\..*got: .*allowed: {name}="):
                type(policy).from_pretrained(tmp_path, config=config)
        else:
            type(policy).from_pretrained(tmp_path, config=config)


def test_options_of_a_checkpoint_that_may_be_changed_exist() -> None:
    for kind in (*AFFORDANCE, "dp3_adaptive"):
        config = PreTrainedConfig.get_choice_class(kind)
        assert {each.name for each in dataclasses.fields(config)} > config.FREE_OPTIONS


@every_affordance
def test_where_no_row_counts_nothing_is_learnt(make: MakePolicy, batch_of: Any, method: str) -> None:
    policy, before, _, dataset = make(method)
    loss, _ = policy.forward(batch_of(dataset, before, len(dataset) - 1))
    assert torch.isfinite(loss)
    loss.backward()
    assert all(weight.grad is not None and not weight.grad.any() for weight in policy.model.parameters())


@pytest.mark.parametrize("method", [*AFFORDANCE, *VARIANTS])
def test_a_checkpoint_acts_and_trains_as_the_saved_policy(
    make: MakePolicy, batch_of: Any, tmp_path: Path, method: str
) -> None:
    policy, before, after, dataset = make(method)
    trained(policy, batch_of(dataset, before, *range(12)), 3, 1e-2)
    if method in VARIANTS:
        policy.update()  # averaged weights that differ from the trained ones
    for part in (policy, before, after):
        part.save_pretrained(tmp_path)
    config = PreTrainedConfig.from_pretrained(tmp_path)
    config.pretrained_path = tmp_path
    loaded = make_policy(config, ds_meta=dataset.meta)
    assert not loaded.training
    saved, found = policy.state_dict(), loaded.state_dict()
    assert saved.keys() == found.keys()
    assert not any(key.startswith("_labels") for key in saved)
    assert all(torch.equal(saved[key], found[key]) for key in saved)
    results = []
    again = make_pre_post_processors(config, pretrained_path=str(tmp_path))
    for actor, (first, last) in ((policy, (before, after)), (loaded, again)):
        torch.manual_seed(4)
        loss = actor.train().forward(batch_of(dataset, first, 3, 5))[0].detach()
        actor.eval().reset()
        torch.manual_seed(4)
        observation = first(observed(toy_world("bottle_000", 1), np.random.default_rng(0)))
        results.append((loss, *(last(actor.select_action(observation)) for _ in range(3))))
    assert results[0][1].shape == (1, schema.ACTION_DIM)
    assert all(torch.equal(one, other) for one, other in zip(*results, strict=True))


@pytest.mark.parametrize("method", [*AFFORDANCE, *VARIANTS])
def test_a_checkpoint_of_other_weights_is_one_clear_error(make: MakePolicy, tmp_path: Path, method: str) -> None:
    policy, *_ = make(method)
    policy.save_pretrained(tmp_path)
    path, weights = tmp_path / "config.json", load_file(tmp_path / "model.safetensors")
    settings = json.loads(path.read_text())
    for changes in ({"encoder_dims": [8, 8]}, {}):
        path.write_text(json.dumps({**settings, **changes}))
        if not changes:  # nor are missing weights left at random
            weights.pop(next(iter(weights)))
            save_file(weights, tmp_path / "model.safetensors")
        with pytest.raises(ConfigurationError, match=r"(?s)does not fit.*got:.*allowed:.*try:") as caught:
            type(policy).from_pretrained(tmp_path)
        assert str(tmp_path) in str(caught.value)
        assert len(str(caught.value)) < 1000


@every_affordance
def test_a_chunk_of_poses_is_followed_to_its_end_whatever_is_seen(make: MakePolicy, method: str) -> None:
    policy, *_ = make(method)
    policy.eval()
    observation = observed(toy_world("bottle_000", 1), np.random.default_rng(0))
    torch.manual_seed(5)
    chunk = policy.predict_action_chunk(observation)
    rows = chunk[..., 3:9].unflatten(-1, (2, 3))
    torch.testing.assert_close(rows @ rows.mT, torch.eye(2).expand(*chunk.shape[:2], 2, 2), rtol=0, atol=1e-5)
    assert ((chunk[..., 9] >= 0) & (chunk[..., 9] <= 1)).all()
    torch.manual_seed(5)
    for wanted in chunk.unbind(dim=1):
        assert torch.equal(policy.select_action(observation), wanted)
        observation = {key: torch.rand_like(value) for key, value in observation.items()}


@every_affordance
def test_episodes_of_a_batch_draw_for_themselves(make: MakePolicy, method: str) -> None:
    policy, *_ = make(method)
    single = observed(toy_world("bottle_000", 1), np.random.default_rng(0))
    batch = {key: value.repeat(2, *[1] * (value.ndim - 1)) for key, value in single.items()}
    actions = torch.stack([policy.eval().select_action(batch) for _ in range(4)])
    assert actions.shape == (4, 2, schema.ACTION_DIM)
    assert not torch.equal(actions[:, 0], actions[:, 1])
