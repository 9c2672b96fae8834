"""Teleoperators that integrate one absolute tool goal. LeRobot finds the classes of `config_devices` in `devices`."""
