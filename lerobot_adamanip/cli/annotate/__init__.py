"""`adamanip annotate`."""
