"""Dense recordings of a robot, and the key frames chosen from them."""
