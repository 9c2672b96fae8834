"""What a policy is conditioned on: the same in training and at run time, and never the answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from lerobot_adamanip.contract import schema
from lerobot_policy_adamanip.common.contacts import END
from lerobot_policy_adamanip.dp3_adaptive.diffusion import CloudUnits

Shape = tuple[str, int, int, int, int]
SHAPES: list[Shape] = [("dp3", 1, 3, 4, 1), ("dp3", 3, 5, 4, 2), ("dp3", 2, 1, 4, 4), ("dp3", 1, 0, 4, 2)]
"""preset, n_obs_steps, n_action_history_steps, horizon, n_action_steps."""
EVERY = [*SHAPES, ("keyframe", 1, 4, 1, 1), ("keyframe", 1, 0, 1, 1)]
MakeTiny = Callable[..., tuple[Any, ...]]
every_shape = pytest.mark.parametrize("shape", EVERY, ids=str)


def _config(shape: Shape) -> dict[str, Any]:
    names = ("preset", "n_obs_steps", "n_action_history_steps", "horizon", "n_action_steps")
    return dict(zip(names, shape, strict=True))


def _shown(window: Any) -> dict[str, torch.Tensor]:
    """What a head may look at: a history before the episode's start is masked."""
    history = window.history.masked_fill(~window.valid[..., None], 0.0)
    return {**window.observations, "history": history, "valid": window.valid}


@every_shape
def test_training_and_run_time_show_a_head_the_same(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, shape: Shape
) -> None:
    policy, before, _, dataset = make_tiny(**_config(shape))
    policy.eval()
    episode = dataset.meta.episodes[1]
    frames = range(episode["dataset_from_index"], episode["dataset_to_index"])
    labels = torch.cat([batch_of(dataset, before, index)[schema.ACTION] for index in frames])
    windows, frame = [], [0]

    def sample(window: Any, _: Any) -> torch.Tensor:
        """Acts as was recorded from the present frame on."""
        windows.append(_shown(window))
        steps = [min(frame[0] + step, len(labels) - 1) for step in range(policy.config.horizon)]
        return labels[steps][None]

    policy.model.sample = sample
    for now, index in enumerate(frames):
        frame[0] = now
        trained = _shown(policy.training_window(batch_of(dataset, before, index))[0])
        assert int(trained["valid"].sum()) == min(now, policy.config.n_action_history_steps)
        observation = observation_of(dataset, before, index)
        # A prediction at every frame, between the borders of chunks too; it must not disturb what follows.
        policy.predict_action_chunk(observation)
        executed = policy.select_action(observation)
        torch.testing.assert_close(executed[0], labels[now], rtol=0, atol=0)
        assert len(windows) == 1 + (now % policy.config.n_action_steps == 0)
        for window in windows:
            for key, value in trained.items():
                torch.testing.assert_close(window[key], value, rtol=0, atol=1e-6, msg=f"{key} at frame {now}")
        windows.clear()


@every_shape
def test_the_first_frame_cannot_see_its_label(make_tiny: MakeTiny, batch_of: Any, shape: Shape) -> None:
    policy, before, _, dataset = make_tiny(**_config(shape))
    policy.eval()
    window, labels, real = policy.training_window(batch_of(dataset, before, 0))
    # Rows before the episode are its first one, whose action is the label: this is the leak that the mask is for.
    assert all(torch.equal(padded, labels[0, 0]) for padded in window.history[0])
    losses = []
    for history in (window.history, window.history + 3.0, torch.full_like(window.history, -7.0)):
        torch.manual_seed(0)
        losses.append(policy.model.loss(replace(window, history=history), labels, real)[0])
    assert all(torch.equal(losses[0], other) for other in losses[1:])


@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape[2]], ids=str)
def test_every_past_action_conditions(make_tiny: MakeTiny, batch_of: Any, shape: Shape) -> None:
    policy, before, _, dataset = make_tiny(**_config(shape))
    policy.eval()
    window, *_ = policy.training_window(batch_of(dataset, before, 6))
    plain = policy.model.condition(window)
    for row in range(window.history.shape[1]):
        changed = window.history.clone()
        changed[:, row] += 0.5
        assert not torch.equal(policy.model.condition(replace(window, history=changed)), plain)


def test_only_the_place_of_a_cloud_among_the_datasets_clouds_conditions(make_tiny: MakeTiny, batch_of: Any) -> None:
    """Clouds that are all moved and enlarged, with their statistics, are the same to the paper's head."""
    policy, before, _, dataset = make_tiny()
    policy.eval()
    window, *_ = policy.training_window(batch_of(dataset, before, 0, 6))
    plain, cloud = policy.model.condition(window), window.observations[schema.POINT_CLOUD]
    changed = replace(window, observations={**window.observations, schema.POINT_CLOUD: 3 * cloud + 0.7})
    assert not torch.allclose(policy.model.condition(changed), plain, atol=1e-3)
    stats = {name: 3 * dataset.meta.stats[schema.POINT_CLOUD][name] + 0.7 for name in ("min", "max")}
    policy.model.cloud_units = CloudUnits({schema.POINT_CLOUD: stats})
    torch.testing.assert_close(policy.model.condition(changed), plain, rtol=0, atol=1e-4)


@pytest.mark.parametrize(("preset", "part"), [("keyframe", "memory"), ("dp3", "history")])
def test_without_history_an_observation_alone_decides(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, preset: str, part: str
) -> None:
    policy, before, _, dataset = make_tiny(preset=preset, n_action_history_steps=0)
    assert getattr(policy.model, part) is None
    assert torch.isfinite(policy.forward(batch_of(dataset, before, 0, 5))[0])
    policy.eval()
    actions = []
    for seen in (5, 2, 5):  # whatever was done before, the same observation leads to the same action
        torch.manual_seed(0)
        actions.append(policy.select_action(observation_of(dataset, before, seen)))
    assert torch.equal(actions[2], actions[0])
    assert not torch.equal(actions[1], actions[0])


def test_an_action_is_remembered_as_the_environment_receives_it(make_tiny: MakeTiny, observation_of: Any) -> None:
    """A network's numbers are no rotation, and a gripper beyond its range; recorded actions are neither."""
    policy, before, after, dataset = make_tiny()
    policy.eval()
    raw = torch.tensor([[0.1, -0.2, 0.3, 0.9, 0.2, 0.0, 0.3, 1.2, 0.1, 1.7]])
    policy.model.sample = lambda *_: raw.expand(1, policy.config.horizon, 10)
    action = policy.select_action(observation_of(dataset, before, 3))
    assert torch.equal(action, raw)
    remembered = policy.executed_history(1, action)[0][:, -1]
    torch.testing.assert_close(remembered[:, 3:], after(action)[:, 3:])
    assert torch.equal(remembered[:, :3], raw[:, :3])


def test_a_memory_is_kept_over_as_many_episodes_as_told(make_tiny: MakeTiny, observation_of: Any) -> None:
    policy, before, _, dataset = make_tiny(preset="keyframe", memory_episodes=3)
    policy.eval()
    policy.reset()  # before the first episode, as LeRobot does
    lengths = []
    for _ in range(5):
        for row in range(2):
            action = policy.select_action(observation_of(dataset, before, row))
        lengths.append(int(policy.executed_history(1, action)[1].sum()))
        for _ in range(1 + len(lengths) % 3):
            policy.reset()  # also several times: only an episode in which the policy has acted counts
    most = policy.config.n_action_history_steps
    assert lengths == [min(most, count) for count in (2, 4, 6, 2, 4)]
    assert policy.executed_history(1, action)[1].any()
    assert policy.executed_history(1, action)[0][:, -1, schema.GRIPPER_DIM] == END
    policy.eval()  # the next evaluation, of another category
    policy.reset()
    assert not policy.executed_history(1, action)[1].any()
