"""Feature schema, key frames, observations, rotations, point clouds, seeds and categories: shared by every package."""
