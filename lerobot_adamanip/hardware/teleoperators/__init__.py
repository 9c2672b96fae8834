"""Teleoperators that integrate one absolute tool goal; each device class stands beside its light configuration."""
