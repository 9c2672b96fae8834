"""Camera calibration: pose and intrinsics, computed from pictures of a board and stored in a file."""
