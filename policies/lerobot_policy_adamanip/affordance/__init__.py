"""Shared parts of vat_mart, adaafford and sampling: networks, options, plans, contact labels."""
