"""Everything that imports SAPIEN or ManiSkill."""
