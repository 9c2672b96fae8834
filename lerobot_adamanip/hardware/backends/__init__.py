"""Arm backends: the real arm and a fake for tests. The twin's backend is in the simulator package."""
