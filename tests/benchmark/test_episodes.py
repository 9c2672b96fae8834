"""Episodes of an evaluation are those that its command requests, or the difference is named."""

from __future__ import annotations

from typing import Any

import pytest
from records import record

from lerobot_adamanip.benchmark.episodes import differing_episodes

OPTIONS = {"--env.type": "adamanip_safe", "--env.objects": "0:2", "--seed": "7", "--env.poses": "randomized"}


@pytest.mark.parametrize(
    ("options", "changes", "difference"),
    [
        ({}, {}, ""),
        ({}, {"object_id": "bottle_000"}, "category bottle, not safe"),
        ({}, {"object_id": "safe_002"}, "object safe_002, not of 0:2"),
        ({"objects": "unseen"}, {"object_id": "safe_036"}, ""),
        ({"assets": "mine"}, {"object_id": "safe:sa1", "object_split": None}, ""),
        ({}, {"mechanism_rules": "upstream"}, "rules upstream, not paper"),
        ({"mechanism_rules": "upstream"}, {"mechanism_rules": "upstream"}, ""),
        ({}, {"poses": "fixed"}, "poses fixed, not randomized"),
        ({}, {"sensing": "rough"}, "sensing rough, not exact"),
        ({"sensing": "'exact, camera_error_mm=5'"}, {"sensing": "exact,camera_error_mm=5"}, ""),
        ({"hints": "0.50"}, {}, "hints 0.0, not 0.5"),
        ({}, {"max_failed_tries": 3}, "limit of failed tries 3, not None"),
        ({"max_failed_tries": "null"}, {}, ""),
        ({"max_failed_tries": "best"}, {}, "limit of failed tries None, not 2"),
        ({"max_failed_tries": "best"}, {"max_failed_tries": 2}, ""),
        ({"episode_length": "30"}, {}, "limit of steps 45, not 30"),
        ({"control": "dense"}, {"max_key_frames": 300}, ""),
        ({"control": "dense", "episode_length": "90"}, {"max_key_frames": 90}, ""),
        ({}, {"given_seed": 8}, "seed 8, not 7"),
    ],
)
def test_a_difference_is_named(options: dict[str, str], changes: dict[str, Any], difference: str) -> None:
    asked = OPTIONS | {f"--env.{name}": value for name, value in options.items()}
    found = differing_episodes([record(**{"given_seed": seed, **changes}) for seed in (8, 7)], asked)
    assert (difference in found) if difference else not found


def test_repeats_have_seeds_of_their_own_and_equal_differences_are_named_once() -> None:
    episodes = [record(seed=7, given_seed=7 + repeat, repeat=repeat, poses="fixed") for repeat in range(3)]
    assert differing_episodes(episodes, {**OPTIONS, "--env.repeats": "3"}) == "poses fixed, not randomized"
