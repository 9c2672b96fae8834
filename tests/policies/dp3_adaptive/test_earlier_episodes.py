"""Histories that begin in another episode: those of a run in which the memory is kept over episodes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common.earlier_episodes import EarlierEpisodes

MakeTiny = Callable[..., tuple[Any, ...]]
STEPS = 12
"""Length of the history: longer than an episode's first key frames, shorter than two episodes."""


def rows_of(dataset: Any, number: int) -> range:
    episode = dataset.meta.episodes[number]
    return range(episode["dataset_from_index"], episode["dataset_to_index"])


def direction(dataset: Any, number: int) -> int:
    value: int = json.loads(dataset.meta.episodes[number]["hidden_state"])["direction"]
    return value


def failed(dataset: Any, number: int) -> list[bool]:
    return [bool(dataset[index][schema.FAILED]) for index in rows_of(dataset, number)]


@pytest.fixture(name="made")
def _made(make_tiny: MakeTiny) -> tuple[Any, ...]:
    return make_tiny(preset="keyframe", n_action_history_steps=STEPS, augmentation_earlier_episodes=1.0)


def pairs(dataset: Any) -> Iterator[tuple[int, int]]:
    """Yields episodes of equal direction."""
    for one in range(dataset.meta.total_episodes):
        for other in range(dataset.meta.total_episodes):
            if one != other and direction(dataset, one) == direction(dataset, other):
                yield one, other


def test_a_continued_history_is_that_of_a_run_in_which_the_memory_is_kept(
    make_tiny: MakeTiny, batch_of: Any, observation_of: Any
) -> None:
    one, other = next(pairs(make_tiny(preset="keyframe")[3]))
    options = {"augmentation_earlier_episodes": 1.0, "memory_episodes": 3, "n_action_history_steps": STEPS}
    policy, before, _, dataset = make_tiny(preset="keyframe", episodes=sorted((one, other)), **options)
    places = {dataset[index]["index"].item(): index for index in range(len(dataset))}
    seen: list[Any] = []
    policy.eval()
    policy.model.sample = lambda window, _: (seen.append(window), acted)[1]
    for number in (other, other, one):
        policy.reset()
        *rows, _final = rows_of(dataset, number)
        for index in rows:
            acted = batch_of(dataset, before, places[index])[schema.ACTION][None]
            policy.select_action(observation_of(dataset, before, places[index]))
    first = [index for index in rows if index - rows[0] < STEPS]
    batch = batch_of(dataset, before, *(places[index] for index in first))
    trained, _, _ = policy.train().training_window(batch)
    for number, window in enumerate(seen[-len(rows) :][: len(first)]):
        torch.testing.assert_close(trained.valid[number], window.valid[0])
        kept = window.valid[0]
        torch.testing.assert_close(trained.history[number][kept], window.history[0][kept], rtol=0, atol=1e-6)
        for states in (slice(0, -1), slice(-1, None)):
            here, there = (each.observations[schema.STATE][at, states] for each, at in ((trained, number), (window, 0)))
            if states.start == 0:
                here, there = here[kept], there[kept]
            torch.testing.assert_close(here, there, rtol=0, atol=1e-6)


def test_what_is_demonstrated_before_a_failed_try_is_no_label_for_who_remembers(made: Any, batch_of: Any) -> None:
    policy, before, _, dataset = made
    for number in range(dataset.meta.total_episodes):
        rows, fails = rows_of(dataset, number), failed(dataset, number)
        batch = batch_of(dataset, before, *rows)
        alone, longer = (policy.train(mode).training_window(batch)[2][:, 0].tolist() for mode in (False, True))
        has_other = any(number == one for one, _ in pairs(dataset))
        for step in range(len(rows)):
            remembers = has_other and step < STEPS
            assert longer[step] == (alone[step] and not (remembers and any(fails[step:]))), (number, step)


def test_only_episodes_with_the_same_hidden_values_are_remembered(made: Any) -> None:
    policy, _, _, dataset = made
    earlier, starts = EarlierEpisodes(dataset.meta, 1.0), {}
    for number in range(dataset.meta.total_episodes):
        starts |= dict.fromkeys(rows_of(dataset, number), number)
    remembered = set()
    for _ in range(40):
        for number in range(dataset.meta.total_episodes):
            present = policy.recorded.rows(torch.tensor([rows_of(dataset, number)[0]]))
            before, valid = policy.recorded.around(present, range(-STEPS, 0))
            rows, valid, *_ = earlier.continued(present, before, valid)
            remembered |= {(number, starts[int(row)]) for row in rows[valid]}
    assert remembered == set(pairs(dataset))


def test_demonstrations_without_hidden_values_are_refused(made: Any) -> None:
    dataset = made[3]

    class Unknown:
        root, features = dataset.meta.root, dataset.meta.features
        episodes = [{"object_id": "bottle_000"}] * dataset.meta.total_episodes

    with pytest.raises(ConfigurationError, match="do not say what was hidden"):
        EarlierEpisodes(Unknown, 1.0)
