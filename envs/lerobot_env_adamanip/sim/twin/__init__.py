"""A simulated twin of the arm: this project's scenes behind the backend that drives a real one, in its own process."""
