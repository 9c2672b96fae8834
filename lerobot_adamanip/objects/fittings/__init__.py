"""Parts that doors and windows share: frames, leaves, handles."""
