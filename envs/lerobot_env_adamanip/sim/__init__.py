"""All modules that import SAPIEN or ManiSkill."""
