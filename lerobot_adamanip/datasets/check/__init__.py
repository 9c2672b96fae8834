"""Validation of a recorded dataset: `dataset.check` returns findings by kind, file, episode and frame."""
