"""Experts open every row of locks and every lock that shuts again, within the tries of the best strategy."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from kinematic import Episode, KinematicWorld, Move, Watched, adaptive, cached_object, run, static

from lerobot_adamanip.catalog import object_id
from lerobot_adamanip.contract.schema import MAX_KEY_FRAMES
from lerobot_adamanip.episode.tries import MIN_JOINT_MOTION
from lerobot_adamanip.experts import Phase, make_expert
from lerobot_adamanip.mechanisms import best_tries, categories_with, make_mechanism
from lerobot_adamanip.util.errors import ConfigurationError

CELLS = [(rules, category) for rules in ("row", "changing") for category in categories_with(rules)]
every_cell = pytest.mark.parametrize(("rules", "category"), CELLS)


def hidden_states(rules: str, category: str) -> Iterator[dict[str, Any]]:
    mechanism = make_mechanism(cached_object(object_id(category, 0)), rules)
    names = [name for name in mechanism.hidden_names if name != "turn_range"]
    for values in itertools.product(*[(-1, 1) if "direction" in name else (False, True) for name in names]):
        yield dict(zip(names, values, strict=True))


def failed_tries(episode: Episode) -> int:
    """Pushes that were felt and moved nothing, up to success: see `lerobot_adamanip.episode.tries`."""
    until = None if episode.key_frames == float("inf") else int(episode.key_frames)
    tries: list[list[Move]] = []
    for before, move in itertools.pairwise([None, *episode.world.moves[:until]]):
        if move is not None and before is not None and (move.joint, move.sign) == (before.joint, before.sign):
            tries[-1].append(move)
        elif move is not None:
            tries.append([move])
    kinds = {name: episode.world.obj.joint(name).kind for name in episode.world.joints}
    return sum(
        abs(each[-1].end - each[0].start) < MIN_JOINT_MOTION[kinds[each[0].joint]]
        and any(move.stalled for move in each)
        for each in tries
    )


def play(rules: str, category: str, hidden: dict[str, Any], kind: Any, seed: int, **options: Any) -> Episode:
    world = KinematicWorld(object_id(category, seed % 3), hidden, draw=seed, layout=seed, preset=rules)
    return run(world, kind(world, seed, **options), at_most=100)


@every_cell
def test_trial_and_error_opens_every_hidden_state_within_the_best_tries(rules: str, category: str) -> None:
    for number, hidden in enumerate(hidden_states(rules, category)):
        episode = play(rules, category, hidden, adaptive, number, preset="to_stop")
        assert episode.key_frames <= MAX_KEY_FRAMES, (hidden, episode.phases)
        assert failed_tries(episode) <= best_tries(category, rules, hidden)[1], (hidden, episode.moves)


@every_cell
def test_sight_fails_only_at_a_lock_that_shuts_again(rules: str, category: str) -> None:
    for number, hidden in enumerate(hidden_states(rules, category)):
        episode = play(rules, category, hidden, static, number)
        assert episode.key_frames <= MAX_KEY_FRAMES, (hidden, episode.phases)
        assert failed_tries(episode) == (rules == "changing" and hidden["relocks"]), (hidden, episode.moves)


@pytest.mark.parametrize("category", categories_with("row"))
def test_demonstrations_of_a_row_try_key_and_pull_first(category: str) -> None:
    """The strategy of the paper's demonstrations draws the second motion: both failures occur."""
    first = set()
    for seed in range(12):
        hidden = {"direction": 1, "second_pulls": bool(seed % 2), "third_pulls": True}
        episode = play("row", category, hidden, adaptive, seed, preset="paper")
        assert episode.key_frames <= 60
        out = next(
            number for number, move in enumerate(episode.moves) if move.joint != episode.world.final and move.end
        )
        later = episode.moves[out + 1 :]
        after = next(move for move in later if (move.joint, move.sign) != (episode.moves[out].joint, 1))
        first.add(after.joint)
    assert first == set(episode.world.joints)


@every_cell
@pytest.mark.parametrize("count", [4, 7, 10])
def test_an_expert_that_takes_over_finishes(rules: str, category: str, count: int) -> None:
    """With the joints' positions and the feedback alone, as after a late start."""
    for number, hidden in enumerate(hidden_states(rules, category)):
        world = KinematicWorld(object_id(category, 0), hidden, draw=number, preset=rules)
        frames = adaptive(world, number)
        goal = next(frames)
        try:
            for _ in range(count):
                goal = frames.send(world.step(goal))
        except StopIteration:
            continue
        known = {"positions": dict(world.joints), "feedback": world.feedback}
        episode = run(world, adaptive(world, number + 1, **known), at_most=100)
        assert max(world.successes), (hidden, episode.phases)


@every_cell
@pytest.mark.parametrize("strategy", ["paper", "to_stop"])
def test_an_expert_asked_anew_at_each_key_frame_opens(rules: str, category: str, strategy: str) -> None:
    """What was felt before leads on: a motion that has failed gives way to another, and one under way is finished."""
    for number, hidden in enumerate(hidden_states(rules, category)):
        watched = Watched(KinematicWorld(object_id(category, 0), hidden, draw=number, preset=rules))
        watched.asked_anew(100 * number, at_most=MAX_KEY_FRAMES, strategy=strategy)


@every_cell
def test_an_expert_that_takes_over_its_own_episode_goes_on_as_it_would_have(rules: str, category: str) -> None:
    for number, hidden in enumerate(hidden_states(rules, category)):
        watched = Watched(KinematicWorld(object_id(category, 0), hidden, draw=number, preset=rules))
        frames = adaptive(watched.world, number, preset="to_stop")
        goal = next(frames)
        while True:
            feedback = watched.step(goal)
            if max(watched.world.successes):
                break
            goal, other = frames.send(feedback), next(watched.taken_over(number, strategy="to_stop"))
            if watched.world.held is not None and goal.phase is not Phase.RELEASE:
                assert other.phase is goal.phase, (hidden, watched.belief.tries[-1:])


def test_an_expert_for_rules_that_a_category_lacks_is_refused() -> None:
    parts = {part.name: part for part in cached_object("lamp_000").parts}
    with pytest.raises(ConfigurationError, match="do not exist for this category"):
        make_expert("lamp", "adaptive", parts, generator=np.random.default_rng(0), mechanism_rules="row")
