"""Errors, files, JSON, worker processes and fingerprints: nothing here knows robots."""
