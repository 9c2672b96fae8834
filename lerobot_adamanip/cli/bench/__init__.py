"""`adamanip bench`."""
