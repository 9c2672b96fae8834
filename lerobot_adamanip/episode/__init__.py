"""Options, rollout loop and contact labels of one simulated episode."""
