"""The policy ``dp3_adaptive``."""
