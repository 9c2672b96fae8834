"""What moves an arm: the real one, and a fake for tests. The twin's backend stands with the simulator."""
