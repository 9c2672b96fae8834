"""`adamanip objects`."""
