"""Depth cameras with stamps; each class is beside its light configuration."""
