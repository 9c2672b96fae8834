"""Annotations of external assets: the file, the initial proposal, and the editing session."""
