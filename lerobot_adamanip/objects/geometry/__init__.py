"""Builders of convex shapes for all generators: boxes, rods, turned bodies, rounded corners."""
