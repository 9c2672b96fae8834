"""The policy ``dp3_adaptive``, over point clouds.

The default preset, ``fast``, is no diffusion: it chooses a typical motion of the demonstrations and refines it. The
paper's method, a diffusion policy conditioned on observations and action history, is the preset ``paper``, or
``diffusion`` with this project's additions.
"""
