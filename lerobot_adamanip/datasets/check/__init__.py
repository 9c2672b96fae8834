"""Check of a recorded dataset: findings by kind, file, episode and frame; and repair after a killed recorder."""
