"""The tables of limits: of the right model, which `franky` has the wrong way round."""

from __future__ import annotations

import numpy as np
import pytest

from lerobot_adamanip.hardware.limits import FR3, MODELS, PANDA, limits_of
from lerobot_adamanip.util.errors import ConfigurationError


def test_the_two_models_are_not_mixed_up() -> None:
    """An FR3 crosses space faster and accelerates less."""
    assert (limits_of("panda"), limits_of("fr3")) == (PANDA, FR3)
    assert (PANDA.translation.velocity, FR3.translation.velocity) == (1.7, 3.0)
    assert FR3.translation.acceleration < PANDA.translation.acceleration
    assert max(FR3.joint_acceleration) < max(PANDA.joint_acceleration)
    assert FR3.joint_velocity[4] > PANDA.joint_velocity[4]
    with pytest.raises(ConfigurationError, match="fr3, panda"):
        limits_of("fer")


@pytest.mark.parametrize("model", MODELS)
def test_the_posture_of_rest_lies_in_the_ranges(model: str) -> None:
    limits = limits_of(model)
    rest = np.array((0.0, -0.78, 0.0, -2.36, 0.0, 1.57, 0.79))
    assert ((rest > limits.joint_lower) & (rest < limits.joint_upper)).all()
