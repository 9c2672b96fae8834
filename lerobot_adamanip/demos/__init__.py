"""Demonstrations: recorded by an observer, durable per episode, published as LeRobotDatasets."""
