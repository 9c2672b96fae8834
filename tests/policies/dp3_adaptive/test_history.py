"""What a policy is conditioned on: the same in training and at run time, and never the answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from lerobot_adamanip.contract import schema

Shape = tuple[str, int, int, int, int]
SHAPES: list[Shape] = [("dp3", 1, 3, 4, 1), ("dp3", 3, 5, 4, 2), ("dp3", 2, 1, 4, 4), ("dp3", 1, 0, 4, 2)]
"""preset, n_obs_steps, n_action_history_steps, horizon, n_action_steps."""
EVERY = [*SHAPES, ("diffusion", 1, 5, 4, 1), ("diffusion", 1, 3, 4, 2), ("diffusion", 1, 0, 4, 4)]
MakeTiny = Callable[..., tuple[Any, ...]]


def _config(shape: Shape) -> dict[str, Any]:
    names = ("preset", "n_obs_steps", "n_action_history_steps", "horizon", "n_action_steps")
    return dict(zip(names, shape, strict=True))


class Spy:
    """Records what enters `condition`, and the vector that leaves it."""

    def __init__(self, policy: Any) -> None:
        self.seen: list[dict[str, torch.Tensor]] = []
        original = policy.head.condition

        def condition(model: Any, window: Any) -> Any:
            vector = original(model, window)
            past = window.history.masked_fill(~window.valid[..., None], 0.0)
            seen = {**window.observations, "history": past, "valid": window.valid, "vector": vector.detach()}
            self.seen.append(seen)
            return vector

        policy.head.condition = condition


def _steer(policy: Any, actions: torch.Tensor) -> Callable[[int], None]:
    """Makes the policy 'generate' what was recorded: the chunk from a given frame on."""
    frame = [0]

    def sample(model: Any, window: Any, noise: Any) -> torch.Tensor:
        policy.head.condition(model, window)
        wanted = [min(frame[0] + step, len(actions) - 1) for step in range(policy.config.horizon)]
        return actions[wanted][None]

    policy.head.sample = sample
    return lambda now: frame.__setitem__(0, now)


@pytest.mark.parametrize("shape", EVERY, ids=str)
def test_training_and_run_time_condition_on_the_same_tensors(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any, shape: Shape
) -> None:
    policy, before, _, dataset = make_tiny(**_config(shape))
    policy.eval()
    spy = Spy(policy)
    episode = dataset.meta.episodes[1]
    frames = range(episode["dataset_from_index"], episode["dataset_to_index"])
    past = policy.config.n_action_history_steps
    labels = torch.cat([batch_of(dataset, before, index)[schema.ACTION] for index in frames])
    at_frame = _steer(policy, labels)
    for now, index in enumerate(frames):
        with torch.no_grad():
            policy.forward(batch_of(dataset, before, index))
        trained = spy.seen.pop()
        observation = observation_of(dataset, before, index)
        # A prediction at every frame, between the borders of chunks too; it must not disturb what follows.
        policy.predict_action_chunk(observation)
        ran = spy.seen.pop()
        for key, value in trained.items():
            torch.testing.assert_close(ran[key], value, rtol=0, atol=1e-6, msg=f"{key} at frame {now}")
        assert int(trained["valid"].sum()) == min(now, past)
        replans = now % policy.config.n_action_steps == 0
        at_frame(now)
        executed = policy.select_action(observation)
        torch.testing.assert_close(executed[0], labels[now], rtol=0, atol=0)
        assert len(spy.seen) == replans
        for generated in spy.seen:
            torch.testing.assert_close(generated["vector"], trained["vector"], rtol=0, atol=1e-6)
        spy.seen.clear()


@pytest.mark.parametrize("shape", EVERY, ids=str)
def test_the_first_frame_cannot_see_its_label(make_tiny: MakeTiny, batch_of: Any, shape: Shape) -> None:
    policy, before, _, dataset = make_tiny(**_config(shape))
    policy.eval()
    spy = Spy(policy)
    window, labels, real = policy.training_window(batch_of(dataset, before, 0))
    # Rows before the episode are its first one, whose action is the label: this is the leak that the mask is for.
    assert all(torch.equal(padded, labels[0, 0]) for padded in window.history[0])
    for history in (window.history, window.history + 3.0, torch.full_like(window.history, -7.0)):
        policy.head.loss(policy.model, replace(window, history=history), labels, real)
    first, *others = (seen["vector"] for seen in spy.seen)
    assert all(torch.equal(first, other) for other in others)


@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape[2]], ids=str)
def test_labels_never_condition_but_every_past_action_does(make_tiny: MakeTiny, batch_of: Any, shape: Shape) -> None:
    policy, before, _, dataset = make_tiny(**_config(shape))
    spy = Spy(policy)
    window, labels, real = policy.training_window(batch_of(dataset, before, 6))
    past = policy.config.n_action_history_steps
    both = torch.cat([window.history, labels], dim=1)
    for row in (*range(both.shape[1]), None):
        changed = both.clone()
        if row is not None:
            changed[:, row] += 0.5
        policy.head.loss(policy.model, replace(window, history=changed[:, :past]), changed[:, past:], real)
    plain = spy.seen.pop()["vector"]
    differs = [not torch.equal(seen["vector"], plain) for seen in spy.seen]
    assert differs == [True] * past + [False] * (len(differs) - past)


@pytest.mark.parametrize(("preset", "part"), [("fast", "memory"), ("diffusion", "memory"), ("dp3", "history")])
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


def test_noise_on_the_history_is_for_training_only(make_tiny: MakeTiny, batch_of: Any) -> None:
    policy, before, _, dataset = make_tiny(n_action_history_steps=3, history_noise_std=0.1)
    spy = Spy(policy)
    batch = batch_of(dataset, before, 6)
    for mode in (True, True, False, False):
        policy.train(mode)
        policy.forward(batch)
    noisy, noisier, clean, cleaner = (seen["history"] for seen in spy.seen)
    assert not torch.equal(noisy, noisier)
    assert torch.equal(clean, cleaner)
    assert torch.equal(clean, policy.training_window(batch)[0].history)


def test_an_action_is_remembered_as_the_environment_receives_it(make_tiny: MakeTiny, observation_of: Any) -> None:
    """A network's numbers are no rotation, and a gripper beyond its range; recorded actions are neither."""
    policy, before, after, dataset = make_tiny()
    policy.eval()
    raw = torch.tensor([[0.1, -0.2, 0.3, 0.9, 0.2, 0.0, 0.3, 1.2, 0.1, 1.7]])
    policy.head.sample = lambda *_: raw.expand(1, policy.config.horizon, 10)
    action = policy.select_action(observation_of(dataset, before, 3))
    assert torch.equal(action, raw)
    remembered = policy.executed_history(1, action)[0][:, -1]
    torch.testing.assert_close(remembered[:, 3:], after(action)[:, 3:])
    assert torch.equal(remembered[:, :3], raw[:, :3])
