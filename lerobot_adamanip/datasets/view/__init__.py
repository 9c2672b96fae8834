"""Show an episode: as a picture, and in rerun."""
