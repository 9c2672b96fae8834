"""The policy ``dp3_adaptive``, over point clouds.

The method is the paper's, a diffusion policy conditioned on observations and action history. The default preset,
``keyframe``, denoises around typical motions of the demonstrations. ``paper`` has the paper's network and parameters.
"""
