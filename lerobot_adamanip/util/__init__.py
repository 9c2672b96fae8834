"""Errors, files, JSON, worker processes; independent of robots."""
