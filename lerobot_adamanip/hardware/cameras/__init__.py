"""Depth cameras with timestamps. Each class has a separate configuration module that imports fast."""
