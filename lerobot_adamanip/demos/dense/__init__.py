"""Dense recordings of a robot, one row per tick of its recorder, and the key frames that are in them."""
