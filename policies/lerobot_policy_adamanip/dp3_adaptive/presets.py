"""Named sets of values for the options of ``dp3_adaptive``; a preset refuses the options that it does not use."""

from __future__ import annotations

from typing import Any

TOOL: dict[str, Any] = {
    "frame": "tool",
    "num_points": 1024, "encoder": "mlp", "encoder_dims": (64, 128, 192), "encoder_out_dim": 128,
    "coarse_points": 512, "training_points": 320, "point_noise_std": 0.002,
    "n_obs_steps": 1, "n_action_history_steps": 16, "n_action_steps": 1,
    "memory_dim": 64, "use_feedback": True, "avoid_repeats": True, "failed_below": 0.25, "num_draws": 4,
    "num_anchors": 32, "num_refinements": 3, "refinement_points": 128, "refinement_reach": 0.1,
    "refinement_spread": 0.006, "scheduler_warmup_steps": 100,
}  # fmt: skip
"""What both heads in the tool's frame use, at a size for two CPU cores."""
DENOISING: dict[str, Any] = {
    "head": "diffusion", "horizon": 4,
    "n_groups": 8, "use_film_scale_modulation": True, "gradient_checkpointing": False,
    "num_train_timesteps": 100, "beta_schedule": "squaredcos_cap_v2", "optimizer_weight_decay": 1e-6,
}  # fmt: skip
BASE: dict[str, Any] = {
    **DENOISING,
    "frame": "base", "proprioception": "full",
    "augmentation_translation": 0.0, "augmentation_yaw": 0.0, "augmentation_center": (0.55, 0.0, 0.0),
    "history_noise_std": 0.0, "kernel_size": 5,
    "clip_sample_range": 1.0, "optimizer_lr": 1e-4, "scheduler_warmup_steps": 500,
}  # fmt: skip
PRESETS: dict[str, dict[str, Any]] = {
    "fast": {
        **TOOL,
        "head": "anchors", "horizon": 1, "trunk_dim": 256, "min_probability": 0.03,
        "optimizer_lr": 1e-3, "optimizer_weight_decay": 1e-4,
    },
    "diffusion": {
        **TOOL, **DENOISING,
        "down_dims": (128, 256), "kernel_size": 3, "diffusion_step_embed_dim": 64,
        "noise_scheduler_type": "DDIM", "prediction_type": "sample", "num_inference_steps": 10,
        "clip_sample_range": 4.0, "optimizer_lr": 1e-3, "num_draws": 8,
    },
    "dp3": {
        **BASE,
        "num_points": 1024, "encoder": "mlp", "encoder_dims": (64, 128, 256), "encoder_out_dim": 64,
        "n_obs_steps": 2, "n_action_history_steps": 0, "n_action_steps": 3,
        "down_dims": (512, 1024, 2048), "diffusion_step_embed_dim": 128,
        "noise_scheduler_type": "DDIM", "prediction_type": "sample", "num_inference_steps": 10,
    },
    "paper": {
        **BASE,
        "num_points": 4096, "encoder": "pointnet2", "encoder_dims": (64, 128, 256, 512), "encoder_out_dim": 128,
        "n_obs_steps": 4, "n_action_history_steps": 4, "n_action_steps": 2,
        "down_dims": (256, 512, 1024), "diffusion_step_embed_dim": 256,
        "noise_scheduler_type": "DDPM", "prediction_type": "epsilon", "num_inference_steps": 100,
    },
}  # fmt: skip
"""``fast``: the head anchors, which is no diffusion. ``diffusion``: the paper's method with this project's tool frame,
memory of contact events and refinement.

``dp3``: 3D Diffusion Policy (Ze et al. 2024) with the values of its release, without an action history.
``--policy.down_dims='[128,256,384]'`` gives the widths of the release's Simple DP3, which a CPU can train; LeRobot's
U-Net has twice its residual blocks. What else differs from the release: docs/differences.md.
``paper``: the paper's table of parameters, except for ``--batch_size=64``. Values missing in the table are those of the
paper's code.
"""
OPTIONS = {name for preset in PRESETS.values() for name in preset}
"""Options that have a value by preset."""
FIXED = ("head", "frame")
"""Options that a preset is made for; their values cannot be changed."""
CHOICES = {
    "encoder": ("mlp", "pointnet2"),
    "proprioception": ("pose", "full"),
    "noise_scheduler_type": ("DDPM", "DDIM"),
    "prediction_type": ("epsilon", "sample"),
}
COUNTS = (
    "num_points", "num_anchors", "memory_dim", "trunk_dim", "training_points", "coarse_points", "refinement_points",
    "num_draws", "num_inference_steps",
)  # fmt: skip
"""Options that are at least 1."""
