"""Shared parts of the policies."""
