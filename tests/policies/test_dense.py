"""Policies at control rate: chunks, a history in contact events, and clear errors for data that do not fit."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from dense_demos import dense_rows, key_frames, record_dense_toy
from scipy.spatial.transform import Rotation
from toy_demos import trained

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.control import DENSE
from lerobot_adamanip.contract.rotations import rotation_6d_from_matrix
from lerobot_adamanip.util.errors import AdaManipError, ConfigurationError
from lerobot_policy_adamanip.common import strokes
from lerobot_policy_adamanip.common.contacts import Past
from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import DP3AdaptiveConfig

Make = Callable[..., tuple[Any, ...]]
PRESETS = ("dense", "dp3")
SHORT: dict[str, Any] = {"n_action_history_steps": 5, "horizon": 8, "n_action_steps": 3}
CODE_MEMORY = {"memory_kind": "code"}


@pytest.fixture(scope="session")
def dense_root(once: Callable[[str, Callable[[Path], object]], Path]) -> Path:
    """Adaptive demonstrations at bottles at 10 Hz. Not to be written to."""
    return once("toy_dense", record_dense_toy)


@pytest.fixture
def make(make_toy_policy: Make, dense_root: Path) -> Make:
    return lambda preset="dense", root=dense_root, **changes: make_toy_policy(
        "dp3_adaptive", root, preset=preset, **changes
    )


def columns(rows: list[dict[str, Any]], key: str) -> torch.Tensor:
    return torch.from_numpy(np.stack([row[key] for row in rows]))[None]


# Strokes --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_contact_events_of_steps_are_those_of_the_key_frames_they_are_made_of(seed: int) -> None:
    frames = key_frames(seed)
    steps = dense_rows(frames)
    commands, states = columns(frames, schema.ACTION)[:, :-1], columns(frames, schema.STATE)
    plain = Past(commands, states[..., :10], torch.ones(commands.shape[:2], dtype=torch.bool))
    sent, seen, valid = strokes.merged(columns(steps, schema.ACTION)[:, :-1], columns(steps, schema.STATE), 40)
    merged = Past(sent, seen[..., :10], valid, is_dense=True)
    expected, events = (past.events()[past.contact] for past in (plain, merged))
    assert len(expected) > 1
    torch.testing.assert_close(events[:, :7], expected[:, :7], rtol=0, atol=0.1)  # commanded, in typical motions
    undone = [rows[:, 7:13].norm(dim=-1) > 1.5 for rows in (events, expected)]  # of the units of a stopped arm
    assert torch.equal(*undone)


def test_what_comes_later_changes_no_stroke() -> None:
    rows = dense_rows(key_frames(0))
    commands, poses = columns(rows, schema.ACTION)[:, :-1], columns(rows, schema.STATE)[..., :10]
    whole = strokes.starts_stroke(commands, poses)
    for steps in range(1, len(rows)):
        assert torch.equal(strokes.starts_stroke(commands[:, :steps], poses[:, : steps + 1]), whole[:, :steps])


# Training and acting --------------------------------------------------------------------------------------------------


def test_training_and_run_time_show_the_head_the_same_strokes(make: Make, batch_of: Any, observation_of: Any) -> None:
    policy, before, _, dataset = make(**SHORT)
    policy.eval()
    windows: list[Any] = []
    policy.model.sample = lambda window, _: windows.append(window) or torch.zeros(1, policy.config.horizon, 10)
    episode, contacts = dataset.meta.episodes[1], 0
    for index in range(episode["dataset_from_index"], episode["dataset_to_index"]):
        policy.predict_action_chunk(observation_of(dataset, before, index))
        (shown,), (trained_on, *_) = windows, policy.training_window(batch_of(dataset, before, index))
        windows.clear()
        assert torch.equal(shown.valid, trained_on.valid)
        for key in (schema.STATE, schema.POINT_CLOUD):
            torch.testing.assert_close(shown.observations[key], trained_on.observations[key], rtol=0, atol=1e-6)
        masks = [window.history.masked_fill(~window.valid[..., None], 0.0) for window in (shown, trained_on)]
        torch.testing.assert_close(*masks, rtol=0, atol=1e-6)
        contacts += int(policy.model.past(shown).contact.sum())
        policy.select_action(observation_of(dataset, before, index))
        policy.replace_latest(dataset[index][schema.EXECUTED][None])
        windows.clear()
    assert contacts > 20


@pytest.mark.parametrize(("preset", "changes"), [*((preset, {}) for preset in PRESETS), ("dense", CODE_MEMORY)])
def test_every_weight_learns_and_the_loss_falls(make: Make, batch_of: Any, preset: str, changes: Any) -> None:
    policy, before, _, dataset = make(preset, **changes)
    assert policy.config.control_fps == 10
    batch = batch_of(dataset, before)
    policy.forward(batch)[0].backward()
    assert all(weight.grad is not None and weight.grad.any() for weight in policy.model.parameters())
    torch.manual_seed(0)
    losses = trained(policy, batch, 40)
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


@pytest.mark.parametrize("preset", PRESETS)
def test_actions_come_in_chunks_and_a_reset_clears_the_history(make: Make, observation_of: Any, preset: str) -> None:
    policy, before, after, dataset = make(preset, horizon=16, n_action_steps=8)
    policy.eval()
    calls, sample = [], policy.model.sample
    policy.model.sample = lambda *args: calls.append(1) or sample(*args)
    episodes = []
    for _ in range(2):
        policy.reset()
        torch.manual_seed(3)
        steps = [after(policy.select_action(observation_of(dataset, before, row))) for row in range(24)]
        episodes.append(torch.stack(steps))
    assert episodes[0].shape == (24, 1, schema.ACTION_DIM)
    assert len(calls) == 2 * 3
    assert torch.equal(*episodes)


def test_the_history_moves_the_action_after_a_contact_event_alone(make: Make, observation_of: Any) -> None:
    policy, before, _, dataset = make(n_action_steps=1)
    policy.eval()
    rows = dataset.meta.episodes[0]["dataset_to_index"] - 1
    differs = []
    for count in range(rows):
        observation = observation_of(dataset, before, count)
        chunks = []
        for memory in (True, False):
            policy.config.inference.memory = memory
            torch.manual_seed(0)
            chunks.append(policy._generate(policy._single(observation), _observed(policy, observation), None))
        differs.append(not torch.equal(*chunks))
        policy.select_action(observation)
        policy.replace_latest(dataset[count][schema.EXECUTED][None])
    first = differs.index(True)
    assert dataset[first - 1][schema.STATE][schema.GRIPPER_DIM] < 0.9, "a hand that holds something has pushed"
    assert all(differs[first:])


def _observed(policy: Any, observation: Any) -> Any:
    observed = policy._observed.copy()
    policy._append_observed(observed, policy._single(observation))
    return observed


def test_the_baseline_learns_from_deltas_too(make: Make, tmp_path: Path, batch_of: Any, observation_of: Any) -> None:
    policy, before, after, dataset = make("dp3", record_dense_toy(tmp_path / "delta", 1, delta=True))
    assert torch.isfinite(policy.forward(batch_of(dataset, before))[0])
    action = after(policy.eval().select_action(observation_of(dataset, before, 0)))
    assert action.shape == (1, 7)


def poses(rows: int, steps: int) -> torch.Tensor:
    """Any poses (rows, steps, 10) within a metre."""
    draw = np.random.default_rng(0)
    turns = rotation_6d_from_matrix(Rotation.random(rows * steps, random_state=0).as_matrix())
    parts = [draw.uniform(-0.5, 0.5, (len(turns), 3)), turns, draw.uniform(size=(len(turns), 1))]
    return torch.from_numpy(np.concatenate(parts, axis=1)).float().reshape(rows, steps, 10)


def test_a_chunk_is_decoded_as_it_was_encoded_and_any_values_become_poses(make: Make, batch_of: Any) -> None:
    policy, before, _, dataset = make("dense")
    window, actions, _ = policy.training_window(batch_of(dataset, before))
    head, bound = policy.model, 4.0
    assert head.encode(actions, window).abs().max() < bound
    for chunk in (actions, poses(*actions.shape[:2])):
        torch.testing.assert_close(head.decode(head.encode(chunk, window), window), chunk, rtol=0, atol=1e-5)
    staying = head.encode(window.observations[schema.STATE][:, -1:, :10], window)
    torch.testing.assert_close(staying[..., :3], torch.zeros(len(actions), 1, 3), rtol=0, atol=1e-4)
    made = head.decode(bound * (2 * torch.rand_like(actions) - 1), window)
    rows = made[..., 3:9].unflatten(-1, (2, 3))
    torch.testing.assert_close(rows @ rows.mT, torch.eye(2).expand(*made.shape[:2], 2, 2), rtol=0, atol=1e-5)
    assert ((made[..., 9] >= 0) & (made[..., 9] <= 1)).all()
    # Of a short motion and a long one, the same error of a value is small relative to each.
    near, far = (head.decode(staying + step * torch.eye(10)[2], window)[..., :3] for step in (0.1, 3.0))
    start = window.observations[schema.STATE][:, -1:, :3]
    assert ((far - start).norm(dim=-1) > 50 * (near - start).norm(dim=-1)).all()


# Data that do not fit -------------------------------------------------------------------------------------------------


def test_the_preset_of_key_frames_refuses_data_at_control_rate(make: Make, refuses: Any) -> None:
    message = refuses(ConfigurationError, lambda: make("keyframe"))
    assert "needs key frames" in message
    assert "10 Hz" in message
    assert "--policy.preset=dense" in message


@pytest.mark.parametrize("kind", ["vat_mart", "sampling", "adaafford"])
def test_macro_actions_refuse_data_at_control_rate(
    make_toy_policy: Make, dense_root: Path, refuses: Any, kind: str
) -> None:
    assert "needs key frames" in refuses(ConfigurationError, lambda: make_toy_policy(kind, dense_root))


def test_the_dense_preset_refuses_key_frames(make: Make, adaptive_toy_root: Path, refuses: Any) -> None:
    message = refuses(ConfigurationError, lambda: make("dense", adaptive_toy_root))
    assert "control rate" in message
    assert "--policy.preset=keyframe" in message


def test_a_checkpoint_refuses_another_rate(make: Make, dense_root: Path, tmp_path: Path, refuses: Any) -> None:
    policy, *_ = make()
    policy.save_pretrained(tmp_path / "checkpoint")
    other = record_dense_toy(tmp_path / "faster", 1, fps=25)
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

    for root, is_same in ((dense_root, True), (other, False)):
        meta = LeRobotDatasetMetadata("local/toy", root=root)
        load = lambda meta=meta: type(policy).from_pretrained(tmp_path / "checkpoint", dataset_meta=meta)  # noqa: E731
        if is_same:
            assert load().config.control_fps == 10
        else:
            assert "allowed: 10 Hz" in refuses(ConfigurationError, load)


def test_data_without_clouds_name_the_options_that_record_them(refuses: Any) -> None:
    from lerobot.configs.types import FeatureType, PolicyFeature

    config = DP3AdaptiveConfig(preset="dense", device="cpu")
    assert config.control == DENSE
    config.input_features = {schema.STATE: PolicyFeature(FeatureType.STATE, (8,))}
    message = refuses(ConfigurationError, config.validate_features)
    assert "--control dense --action ee_pose --state full --cloud" in message
    config.input_features |= {
        schema.STATE: PolicyFeature(FeatureType.STATE, (24,)),
        schema.POINT_CLOUD: PolicyFeature(FeatureType.ENV, (3072,)),
    }
    config.output_features = {schema.ACTION: PolicyFeature(FeatureType.ACTION, (7,))}
    config.validate_features()
    assert "--action ee_pose" in refuses(ConfigurationError, config.require_poses)


def test_at_control_rate_the_rule_of_key_frames_is_refused(refuses: Any) -> None:
    from lerobot_policy_adamanip.dp3_adaptive.configuration_dp3_adaptive import Inference

    for used in (Inference(memory=False), Inference(latest_events=1)):
        assert DP3AdaptiveConfig(preset="dense", device="cpu", inference=used).inference == used
    rule = Inference(no_repeat=True)
    refuses(AdaManipError, lambda: DP3AdaptiveConfig(preset="dense", device="cpu", inference=rule))


def test_what_is_no_pose_is_not_mirrored_in_silence(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DP3AdaptiveConfig, "has_pose_layout", False)
    with pytest.raises(ConfigurationError, match=r"(?s)Only poses can be mirrored.*--control dense --action ee_pose"):
        make("dp3", augmentation_mirror=0.5)
