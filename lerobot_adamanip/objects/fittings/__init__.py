"""What doors and windows have in common: frames, leaves, handles."""
