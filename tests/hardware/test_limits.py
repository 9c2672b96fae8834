"""The tables of limits: of the right model, and what the simulated arm rests in fits both."""

from __future__ import annotations

import numpy as np
import pytest

from lerobot_adamanip.hardware.limits import FR3, MODELS, PANDA, Bounds, limits_of, planned_velocity
from lerobot_adamanip.util.errors import ConfigurationError


def test_the_two_models_are_not_mixed_up() -> None:
    """An FR3 crosses space faster and accelerates less: what `franky` has the wrong way round."""
    assert limits_of("panda") is PANDA
    assert limits_of("fr3") is FR3
    assert (PANDA.translation.velocity, FR3.translation.velocity) == (1.7, 3.0)
    assert FR3.translation.acceleration < PANDA.translation.acceleration
    assert max(FR3.joint_acceleration) < max(PANDA.joint_acceleration)
    assert FR3.joint_velocity[4] > PANDA.joint_velocity[4]
    with pytest.raises(ConfigurationError, match="fr3, panda"):
        limits_of("fer")


def test_five_percent_is_of_our_table() -> None:
    assert planned_velocity("panda", 0.05) == pytest.approx(0.085)
    assert planned_velocity("fr3", 0.05) == pytest.approx(0.15)
    assert Bounds(3.0, 9.0, 4500.0).scaled(0.05) == Bounds(3.0 * 0.05, 9.0 * 0.05, 4500.0 * 0.05)


@pytest.mark.parametrize("model", MODELS)
def test_ranges_are_ranges_and_posture_of_rest_lies_in_them(model: str) -> None:
    limits = limits_of(model)
    lower, upper = np.array(limits.joint_lower), np.array(limits.joint_upper)
    assert (upper - lower > 2.5).all()
    rest = np.array((0.0, -0.78, 0.0, -2.36, 0.0, 1.57, 0.79))
    assert ((rest > lower) & (rest < upper)).all()
    for joint in range(7):
        bounds = limits.joint_bounds(joint)
        assert 1.0 < bounds.velocity < 6.0 < bounds.acceleration < 25.0 < bounds.jerk
