"""Looking at an episode: as a picture, and in rerun's viewer, from the same data."""
