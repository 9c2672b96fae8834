"""Dense recordings of a robot and their conversion to key frames."""
