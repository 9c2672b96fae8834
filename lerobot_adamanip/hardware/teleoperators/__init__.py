"""Teleoperators that integrate one absolute tool goal. LeRobot loads their classes from `devices`."""
