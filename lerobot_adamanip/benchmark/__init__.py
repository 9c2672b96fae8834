"""Benchmark of methods x categories x splits x seeds, from one declaration to one table: `adamanip benchmark`."""
