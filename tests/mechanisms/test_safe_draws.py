"""What the safe draws at reset: from the given generator alone, as often as configured, and as overridden."""

from __future__ import annotations

import json
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_adamanip.mechanisms import SafeMechanism, SafeMechanismConfig
from lerobot_adamanip.util.errors import ConfigurationError

DOOR_UPPER, NOMINAL = 1.578, 1.5
SAFE = SafeMechanism(DOOR_UPPER, NOMINAL)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@given(st.integers(0, 2**31 - 1))
@settings(max_examples=30, deadline=None)
def test_equal_seeds_give_equal_draws_and_hidden_values_reproduce_an_episode(seed: int) -> None:
    state = SAFE.draw(3, generator(seed))
    assert repr(state) == repr(SAFE.draw(3, generator(seed)))
    hidden = json.loads(json.dumps(SAFE.hidden(state, 1)))
    assert SAFE.hidden(SAFE.draw(1, generator(seed + 1), hidden), 0) == hidden


@pytest.mark.parametrize("overrides", [{"locked": True}, {"locked": False}, {"direction": -1}, {"knob_range": 1.2}])
def test_an_override_changes_its_own_value_and_no_other_draw(overrides: dict[str, Any]) -> None:
    free, fixed = generator(7), generator(7)
    drawn, forced = SAFE.draw(16, free), SAFE.draw(16, fixed, overrides)
    for i in range(16):
        assert SAFE.hidden(forced, i) == SAFE.hidden(drawn, i) | overrides
    assert torch.equal(free.get_state(), fixed.get_state())


def test_draw_frequencies_are_as_configured() -> None:
    count = 4000
    mechanism = SafeMechanism(DOOR_UPPER, NOMINAL, config=SafeMechanismConfig(p_locked=0.3, p_clockwise=0.8))
    state = mechanism.draw(count, generator())
    hidden = [mechanism.hidden(state, i) for i in range(count)]
    assert sum(h["locked"] for h in hidden) / count == pytest.approx(0.3, abs=0.03)
    assert sum(h["direction"] == 1 for h in hidden) / count == pytest.approx(0.8, abs=0.03)
    ranges = torch.tensor([h["knob_range"] for h in hidden]) / NOMINAL
    assert 0.9 <= ranges.min() < 0.905
    assert 0.995 < ranges.max() <= 1.0
    assert ranges.mean() == pytest.approx(0.95, abs=0.003)
    both_true = sum(h["locked"] and h["direction"] == 1 for h in hidden) / count
    assert both_true == pytest.approx(0.3 * 0.8, abs=0.03), "draws are independent"


@pytest.mark.parametrize("p", [0.0, 1.0])
def test_probabilities_of_zero_and_one_are_certain(p: float) -> None:
    mechanism = SafeMechanism(DOOR_UPPER, NOMINAL, config=SafeMechanismConfig(p_locked=p))
    state = mechanism.draw(500, generator())
    assert {mechanism.hidden(state, i)["locked"] for i in range(500)} == {bool(p)}


@pytest.mark.parametrize(
    "overrides",
    [
        {"lokced": True},
        {"locked": "yes"},
        {"locked": 2},
        {"direction": 0},
        {"knob_range": -1.0},
        {"knob_range": float("nan")},
    ],
)
def test_a_wrong_override_is_refused_with_what_is_allowed(overrides: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="allowed:"):
        SAFE.draw(1, generator(), overrides)


@pytest.mark.parametrize(
    "options",
    [
        {"p_locked": 1.1}, {"p_locked": -0.1}, {"p_locked": float("nan")}, {"p_clockwise": 2.0},
        {"release_fraction": 0.0}, {"release_fraction": 1.2}, {"range_fraction": (1.0, 0.9)},
        {"range_fraction": (0.0, 1.0)}, {"range_fraction": (0.5, 1.5)},
    ],
)  # fmt: skip
def test_an_impossible_configuration_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigurationError, match="allowed:"):
        SafeMechanism(DOOR_UPPER, NOMINAL, config=SafeMechanismConfig(**options))


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_size_is_refused(value: float) -> None:
    with pytest.raises(ConfigurationError, match="allowed:"):
        SafeMechanism(value, NOMINAL)
    with pytest.raises(ConfigurationError, match="allowed:"):
        SafeMechanism(DOOR_UPPER, value)
