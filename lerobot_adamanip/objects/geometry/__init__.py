"""Builders of convex shapes that every generator shares: boxes and rods, things turned on a lathe, round corners."""
