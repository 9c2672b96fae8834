"""Depth cameras that tell when a picture was taken; each class stands beside its light configuration."""
