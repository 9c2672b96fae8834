"""`adamanip doctor`."""
