"""The loss, its labels, its gradients, the averaged weights, half precision and fine-tuning."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from lerobot_adamanip.contract import schema
from lerobot_adamanip.contract.pointcloud import as_points
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.inputs import DEPARTS, EPISODE, INDEX, IS_LABEL, read_recorded_rows
from lerobot_policy_adamanip.common.motion_clusters import demonstrated_motions
from lerobot_policy_adamanip.dp3_adaptive import modeling_dp3_adaptive

MakeTiny = Callable[..., tuple[Any, ...]]


def test_what_lies_beyond_the_episodes_end_is_not_learned(make_tiny: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_tiny()
    policy.eval()
    end = next(row for row in range(len(dataset)) if dataset[row][schema.DONE])
    batch = batch_of(dataset, before, end - 1, 3)
    window, labels, real = policy.training_window(batch)
    assert real.tolist() == [[True] + [False] * 3, [True] * 4]
    wild = labels.clone()
    wild[0, -3:] = 50.0
    losses = []
    for actions in (labels, wild):
        torch.manual_seed(3)
        policy.training_window = lambda _, actions=actions: (window, actions, real)
        losses.append(policy.forward(batch, reduction="none")[0])
    torch.manual_seed(3)
    torch.testing.assert_close(policy.forward(batch)[0], losses[1].mean())
    # The U-Net sees padded rows beside real ones, so the prediction may differ; an error of 50 squared may not enter.
    assert losses[1].max() < 100
    assert torch.equal(losses[0][1], losses[1][1])


def test_a_chunks_labels_end_where_something_else_was_sent(
    make_toy_policy: MakeTiny, adaptive_toy_root: Path, batch_of: Any, tmp_path: Path
) -> None:
    root = Path(shutil.copytree(adaptive_toy_root, tmp_path / "mistaken"))
    (file,) = (root / "data").rglob("*.parquet")
    table = pq.read_table(file)
    sent = np.stack(table[schema.EXECUTED].to_numpy())
    sent[2, 0] += 0.1  # a mistake
    sent[5, 0] += 0.001  # the same motion
    field = table.schema.field(schema.EXECUTED)
    place = table.schema.get_field_index(schema.EXECUTED)
    pq.write_table(table.set_column(place, field, pa.array(list(sent), field.type)), file)
    policy, before, _, dataset = make_toy_policy("dp3_adaptive", root)
    _, _, real = policy.training_window(batch_of(dataset, before, 0, 1, 2, 3))
    assert real.sum(dim=1).tolist() == [3, 2, 1, 4]


def test_a_dense_chunks_labels_end_with_the_key_frame_that_was_executed_otherwise(tmp_path: Path) -> None:
    pose, other = [0.0] * 10, [0.1] * 10
    columns = {INDEX: range(7), EPISODE: [0] * 5 + [1] * 2, schema.STATE: [pose] * 7, schema.ACTION: [pose] * 7}
    columns |= {schema.EXECUTED: [other, pose, pose, pose, pose, other, pose]}
    columns |= {schema.OUTCOME: [-1, 0, -1, 1, -1, -1, -1], schema.DONE: [False] * 4 + [True, False, True]}
    (tmp_path / "data").mkdir()
    pq.write_table(pa.table(columns), tmp_path / "data" / "a.parquet")
    recorded = read_recorded_rows(SimpleNamespace(root=tmp_path, features=columns))
    ends = [False, True, False, False, False, False, True]
    assert recorded.column(DEPARTS, torch.arange(7)).tolist() == ends


def test_it_can_learn(make_tiny: MakeTiny, batch_of: Any) -> None:
    """The others: tests/policies/dp3_adaptive/test_heads.py."""
    policy, before, _, dataset = make_tiny(preset="dp3")
    batch = batch_of(dataset, before, 0, 5)
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=3e-3)

    def loss() -> torch.Tensor:
        torch.manual_seed(0)
        return torch.stack([policy.forward(batch)[0] for _ in range(4)]).mean()

    before_training = loss().item()
    for _ in range(40):
        optimizer.zero_grad()
        policy.forward(batch)[0].backward()
        optimizer.step()
    assert loss().item() < 0.5 * before_training


def test_averaged_weights_follow_and_are_used_only_outside_training(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, before, _, dataset = make_tiny(n_action_history_steps=0)
    trained, averaged = list(policy.model.parameters()), list(policy.ema_model.parameters())
    start = [weight.clone() for weight in averaged]
    optimised = {id(weight) for weight in policy.get_optim_params()}
    assert optimised == {id(weight) for weight in trained}
    assert not any(weight.requires_grad for weight in averaged)
    with torch.no_grad():
        for weight in trained:
            weight.add_(1.0)
    policy.train().update()
    assert int(policy.ema_steps) == 1
    for weight, average, old in zip(trained, averaged, start, strict=True):
        assert torch.all((average > old) & (average < weight))
    for _ in range(300):
        policy.update()
    assert int(policy.ema_steps) == 301
    torch.testing.assert_close(averaged, trained, rtol=1e-3, atol=1e-3)
    policy.load_state_dict(policy.state_dict())
    policy.update()
    assert int(policy.ema_steps) == 1, "fine-tuning averages anew"
    policy.load_state_dict(policy.state_dict())
    monkeypatch.setattr(sys, "argv", ["lerobot-train", "--resume=true"])
    policy.update()
    assert int(policy.ema_steps) == 2
    monkeypatch.setattr(modeling_dp3_adaptive, "EMA_MAX", 0.5)
    with torch.no_grad():
        averaged[0].sub_(1.0)
    policy.update()
    torch.testing.assert_close(averaged[0], trained[0] - 0.5, rtol=1e-3, atol=2e-3)

    batch, observation = batch_of(dataset, before, 4), observation_of(dataset, before, 4)
    noise = torch.randn(1, policy.config.horizon, 10)

    def outcome(mode: bool) -> torch.Tensor:
        policy.train(mode)
        torch.manual_seed(0)
        loss = policy.forward(batch)[0].detach()
        policy.reset()
        return loss if mode else torch.cat([loss.flatten(), policy.select_action(observation, noise=noise).flatten()])

    training, evaluating = outcome(True), outcome(False)
    with torch.no_grad():
        averaged[-1].add_(1.0)
    assert torch.equal(outcome(True), training)
    assert not torch.equal(outcome(False), evaluating)
    with torch.no_grad():
        averaged[-1].sub_(1.0)
        trained[-1].add_(1.0)
    assert not torch.equal(outcome(True), training)
    torch.testing.assert_close(outcome(False), evaluating, rtol=1e-4, atol=1e-4)


def test_only_the_first_points_are_used_and_too_few_are_refused(make_tiny: MakeTiny, observation_of: Any) -> None:
    policy, before, _, dataset = make_tiny()
    policy.eval()
    noise = torch.randn(1, policy.config.horizon, 10)
    observation = observation_of(dataset, before, 3)
    cloud = as_points(observation[schema.POINT_CLOUD])

    def act(points: torch.Tensor) -> torch.Tensor:
        policy.reset()
        chosen: torch.Tensor = policy.select_action({**observation, schema.POINT_CLOUD: points}, noise=noise)
        return chosen

    full = act(cloud)
    assert torch.equal(act(cloud.flatten(-2)), full)
    assert torch.equal(act(cloud[:, :32]), full)
    assert torch.equal(act(torch.cat([cloud[:, :32], torch.rand(1, 99, 3)], dim=1)), full)
    assert not torch.equal(act(cloud + 0.1), full)
    with pytest.raises(ConfigurationError, match="31"):
        act(cloud[:, :31])


@pytest.mark.skipif(not torch.ops.mkldnn._is_mkldnn_bf16_supported(), reason="this CPU does not run bfloat16")
@pytest.mark.parametrize("preset", ["keyframe", "dp3"])
def test_a_policy_trains_and_acts_in_half_precision(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, preset: str
) -> None:
    policy, before, _, dataset = make_tiny(preset=preset, use_amp=True)
    with torch.autocast("cpu", torch.bfloat16):
        loss, _ = policy.forward(batch_of(dataset, before))
        loss.backward()
        assert all(weight.grad is not None for weight in policy.get_optim_params())
        action = policy.eval().select_action(observation_of(dataset, before, 0, 5))
    assert torch.isfinite(loss)
    assert action.dtype == torch.float32
    assert torch.isfinite(action).all()


def test_a_policy_with_an_average_refuses_adapters(make_tiny: MakeTiny) -> None:
    policy, *_ = make_tiny()
    policy.config.pretrained_path = "checkpoint"
    for hook in (policy._get_default_peft_targets, lambda: policy._validate_peft_config(object())):
        with pytest.raises(ConfigurationError, match=r"(?s)cannot be trained with PEFT.*without --peft"):
            hook()


def test_the_files_say_where_episodes_end(tmp_path: Path) -> None:
    pose = np.array([0.5, 0, 0.7, 1, 0, 0, 0, 1, 0, 0.3], np.float32)
    columns = {INDEX: range(5), EPISODE: [0, 0, 1, 1, 1], schema.STATE: [pose] * 5, schema.ACTION: [pose] * 5}
    ends = {schema.DONE: [False, True, False, True, True]}
    (tmp_path / "data").mkdir()
    pq.write_table(pa.table({**columns, **ends}), tmp_path / "data" / "a.parquet")
    for extra, labels in ((ends, [True, False, True, False, False]), ({}, [True] * 5)):
        recorded = read_recorded_rows(SimpleNamespace(root=tmp_path, features=[*columns, *extra]))
        assert recorded.column(IS_LABEL, torch.arange(5)).tolist() == labels
        expected = torch.tensor([0.0] * 6 + [0.3]).expand(sum(labels), 7)
        torch.testing.assert_close(demonstrated_motions(recorded), expected)


def test_fine_tuning_on_other_motions_warns(
    make_tiny: MakeTiny, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, *_, dataset = make_tiny(preset="keyframe")
    policy.save_pretrained(tmp_path)
    again = type(policy).from_pretrained(tmp_path, dataset_meta=dataset.meta)
    assert "spreads from every anchor" not in caplog.text
    assert torch.equal(again.model.motions.anchors, policy.model.motions.anchors)
    other = demonstrated_motions(policy.recorded) + 1.0
    monkeypatch.setattr(modeling_dp3_adaptive, "demonstrated_motions", lambda _: other)
    type(policy).from_pretrained(tmp_path, dataset_meta=dataset.meta)
    assert "spreads from every anchor" in caplog.text


def test_a_training_step_passes_few_files(make_tiny: MakeTiny, batch_of: Any) -> None:
    """What a reader has to open to know the default's loss."""
    policy, before, _, dataset = make_tiny(preset="keyframe")
    batch, files = batch_of(dataset, before), set()
    policy.forward(batch)  # the first batch is checked

    def note(frame: Any, event: str, _: Any) -> None:
        if event == "call" and "adamanip" in (path := Path(frame.f_code.co_filename)).parent.as_posix():
            files.add(path)

    sys.setprofile(note)
    try:
        policy.forward(batch)
    finally:
        sys.setprofile(None)
    ours = {path for path in files if "site-packages" not in path.parts and "tests" not in path.parts}
    assert 3 <= len(ours) <= 7, sorted(ours)  # one of them says what a felt try is, for every policy
