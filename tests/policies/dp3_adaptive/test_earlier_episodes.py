"""Histories that begin in another episode: those of a run in which the memory is kept over episodes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from lerobot_adamanip.contract import schema
from lerobot_adamanip.util.errors import ConfigurationError
from lerobot_policy_adamanip.common import earlier_episodes
from lerobot_policy_adamanip.common.earlier_episodes import EarlierEpisodes
from lerobot_policy_adamanip.common.inputs import read_columns

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


def continued_at_the_start(policy: Any, meta: Any, episodes: list[range]) -> tuple[set[tuple[int, int]], set[int]]:
    """Pairs of an episode and one that its first row remembers, and the rows where an earlier episode ended."""
    earlier, of_row = EarlierEpisodes(meta, 1.0, STEPS), {}
    for number, rows in enumerate(episodes):
        of_row |= dict.fromkeys(rows, number)
    taken, ended = set(), set()
    for _ in range(40):
        for number, rows in enumerate(episodes):
            present = policy.recorded.rows(torch.tensor([rows[0]]))
            before, valid = policy.recorded.around(present, range(-STEPS, 0))
            before, valid, is_last, _ = earlier.continued(present, before, valid)
            taken |= {(number, of_row[int(row)]) for row in before[valid]}
            ended |= {int(row) for row in before[is_last]}
    return taken, ended


def test_only_episodes_with_the_same_hidden_values_are_remembered(made: Any) -> None:
    policy, _, _, dataset = made
    episodes = [rows_of(dataset, number) for number in range(dataset.meta.total_episodes)]
    assert continued_at_the_start(policy, dataset.meta, episodes)[0] == set(pairs(dataset))


def test_an_earlier_episode_ends_with_the_command_that_succeeds_as_a_run_does(
    made: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, _, _, dataset = made
    episodes = [rows_of(dataset, number) for number in range(dataset.meta.total_episodes)]

    def read(*args: Any) -> Any:
        columns = read_columns(*args)
        for rows in episodes:  # two commands and the final observation follow the success
            columns[schema.SUCCESS][rows[-4] : rows[-1] + 1] = True
        return columns

    monkeypatch.setattr(earlier_episodes, "read_columns", read)
    _, ended = continued_at_the_start(policy, dataset.meta, episodes)
    assert ended == {episodes[other][-4] for _, other in pairs(dataset)}


def test_what_starts_amid_the_task_continues_no_other_episode(made: Any) -> None:
    policy, _, _, dataset = made
    episodes = [rows_of(dataset, number) for number in range(dataset.meta.total_episodes)]
    late, other = next(pairs(dataset))

    changed = [{**each, "late": number == late} for number, each in enumerate(dataset.meta.episodes)]
    meta = SimpleNamespace(root=dataset.meta.root, features=dataset.meta.features, episodes=changed)
    taken, _ = continued_at_the_start(policy, meta, episodes)
    assert late not in {present for present, _ in taken}
    assert (other, late) in taken


def test_demonstrations_without_hidden_values_are_refused(made: Any) -> None:
    dataset = made[3]

    class Unknown:
        root, features = dataset.meta.root, dataset.meta.features
        episodes = [{"object_id": "bottle_000"}] * dataset.meta.total_episodes

    with pytest.raises(ConfigurationError, match="do not say what was hidden"):
        EarlierEpisodes(Unknown, 1.0, STEPS)


def test_a_policy_that_remembers_nothing_is_not_trained_so(make_tiny: MakeTiny) -> None:
    with pytest.raises(ConfigurationError, match="remembers no episode"):
        make_tiny(preset="keyframe", n_action_history_steps=0, augmentation_earlier_episodes=0.5)


def test_external_assets_of_one_category_remember_each_other() -> None:
    def named(asset: str) -> str:
        return earlier_episodes._hidden_values({"object_id": asset, "hidden_state": '{"direction": 1}'})

    assert named("safe:a_1") == named("safe:b") != named("window:b")
