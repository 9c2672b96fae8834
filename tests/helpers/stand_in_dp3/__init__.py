"""A policy ``dp3`` that reads what the one of LeRobot's pull request 4696 reads. Its own code, not that one's."""

from lerobot_policy_stand_in import configuration_dp3  # noqa: F401
