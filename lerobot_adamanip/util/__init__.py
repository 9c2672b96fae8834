"""Errors, files, JSON, worker processes and fingerprints; independent of robots."""
