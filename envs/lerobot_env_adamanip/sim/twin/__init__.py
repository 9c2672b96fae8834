"""Simulated twin of the arm: this project's scenes as a backend of the arm process."""
