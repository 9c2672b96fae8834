"""select_action and predict_action_chunk: what they leave alone, remember and forget."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from typing import Any

import torch

from lerobot_adamanip.contract import schema

MakeTiny = Callable[..., tuple[Any, ...]]


def test_every_sampler_gives_finite_actions_that_noise_and_seed_decide(
    make_tiny: MakeTiny, observation_of: Any
) -> None:
    for kind, preset in itertools.product(("DDPM", "DDIM"), ("paper", "dp3")):  # epsilon, sample
        policy, before, after, dataset = make_tiny(preset=preset, noise_scheduler_type=kind, n_action_steps=2)
        policy.eval()
        observation = observation_of(dataset, before, 3, 14)
        noise = torch.randn(2, policy.config.horizon, 10)

        def act(start: torch.Tensor, policy: Any = policy, observation: Any = observation) -> torch.Tensor:
            policy.reset()
            torch.manual_seed(5)
            return torch.stack([policy.select_action(observation, noise=start) for _ in range(3)])

        actions = act(noise)
        assert actions.shape == (3, 2, 10)
        assert torch.isfinite(after(actions[0])).all()
        assert torch.equal(act(noise), actions)
        assert not torch.equal(act(noise + 0.5), actions)


def test_a_chunk_predicted_changes_nothing_and_is_the_one_that_follows(
    make_tiny: MakeTiny, observation_of: Any
) -> None:
    policy, before, _, dataset = make_tiny(n_obs_steps=3, n_action_history_steps=4, n_action_steps=2)
    policy.eval()
    noise = torch.randn(1, policy.config.horizon, 10)
    for step in range(4):
        # lerobot-eval's batches hold more than the observation.
        batch = {**observation_of(dataset, before, step), schema.ACTION: None, "task": ["open the safe"], "info": {}}
        given, history = copy.deepcopy(batch), policy.executed_history(1, noise)
        chunk = policy.predict_action_chunk(batch, noise=noise)
        assert torch.equal(policy.predict_action_chunk(batch, noise=noise), chunk)
        assert all(torch.equal(*pair) for pair in zip(policy.executed_history(1, noise), history, strict=True))
        action = policy.select_action(batch, noise=noise)
        if step % 2 == 0:
            assert torch.equal(action, chunk[:, 0])
        assert batch.keys() == given.keys()
        assert all(torch.equal(batch[key], given[key]) for key in (schema.STATE, schema.POINT_CLOUD))


def test_reset_forgets_the_episode_which_decides_what_is_done(make_tiny: MakeTiny, observation_of: Any) -> None:
    policy, before, _, dataset = make_tiny(n_obs_steps=2, n_action_steps=3, n_action_history_steps=4)
    policy.eval()
    noise = torch.randn(1, policy.config.horizon, 10)

    def episode() -> torch.Tensor:
        steps = (policy.select_action(observation_of(dataset, before, step), noise=noise) for step in range(5))
        return torch.stack(list(steps))

    first = episode()
    assert not torch.equal(episode(), first)
    policy.reset()
    assert torch.equal(episode(), first)
    policy.reset()
    # Another number of environments is another rollout; a single observation needs no batch dimension.
    assert policy.select_action(observation_of(dataset, before, 0, 1, 2)).shape == (3, 10)
    policy.reset()
    single = {key: dataset[4][key][-1] for key in (schema.POINT_CLOUD, schema.STATE)}
    assert policy.select_action(before(single)).shape == (1, 10)


def test_an_observation_without_a_batch_dimension_is_one_of_a_batch(make_tiny: MakeTiny, observation_of: Any) -> None:
    policy, before, _, dataset = make_tiny(preset="keyframe", use_effort=True)
    policy.eval()
    noise = torch.full((1, 1, 10), 0.3)
    batched = policy.select_action(observation_of(dataset, before, 4), noise=noise)
    policy.reset()
    single = before({key: dataset[4][key] for key in policy.config.input_features})
    assert torch.equal(policy.select_action(single, noise=noise), batched)


def test_no_environment_sees_another(make_tiny: MakeTiny, observation_of: Any) -> None:
    policy, before, _, dataset = make_tiny(n_obs_steps=2, n_action_history_steps=3, n_action_steps=2)
    policy.eval()
    noise = torch.randn(3, 4, 10)
    walks = [(0, 10, 22), (1, 11, 23), (2, 12, 24), (3, 13, 25), (4, 14, 26)]

    def run(rows: list[int]) -> torch.Tensor:
        policy.reset()
        taken = [
            policy.select_action(observation_of(dataset, before, *(step[row] for row in rows)), noise=noise[rows])
            for step in walks
        ]
        return torch.stack(taken)

    together = run([0, 1, 2])
    for rows in ([0], [1], [2], [0, 2], [2, 0, 1]):
        torch.testing.assert_close(run(rows), together[:, rows], rtol=0, atol=1e-5)
