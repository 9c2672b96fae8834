"""Named sets of values for the options of ``dp3_adaptive``."""

from __future__ import annotations

from typing import Any

DIFFUSION: dict[str, Any] = {
    "head": "diffusion",
    "num_points": 512, "encoder": "mlp", "encoder_dims": (64, 128, 192), "encoder_out_dim": 128,
    "tcp_relative": True, "proprioception": "pose",
    "n_obs_steps": 1, "n_action_history_steps": 8, "horizon": 4, "n_action_steps": 1,
    "down_dims": (128, 256), "kernel_size": 3, "diffusion_step_embed_dim": 64,
    "noise_scheduler_type": "DDIM", "prediction_type": "sample", "num_inference_steps": 10,
    "augmentation_translation": 0.03, "augmentation_yaw": 0.1, "history_noise_std": 0.02,
    "clip_sample_range": 6.0, "optimizer_lr": 5e-4, "optimizer_weight_decay": 1e-6, "scheduler_warmup_steps": 100,
}  # fmt: skip
"""The diffusion head at a size for two CPU cores; ``fast`` lists its differences."""
PRESETS: dict[str, dict[str, Any]] = {
    "fast": {
        **DIFFUSION,
        "head": "anchors", "num_points": 1024, "n_action_history_steps": 16, "horizon": 1,
        "augmentation_translation": 0.0, "augmentation_yaw": 0.0, "history_noise_std": 0.0,
        "optimizer_lr": 1e-3, "optimizer_weight_decay": 1e-4,
    },
    "diffusion": DIFFUSION,
    "dp3": {
        "head": "diffusion",
        "num_points": 1024, "encoder": "mlp", "encoder_dims": (64, 128, 256), "encoder_out_dim": 64,
        "tcp_relative": False, "proprioception": "full",
        "n_obs_steps": 2, "n_action_history_steps": 0, "horizon": 4, "n_action_steps": 3,
        "down_dims": (512, 1024, 2048), "kernel_size": 5, "diffusion_step_embed_dim": 128,
        "noise_scheduler_type": "DDIM", "prediction_type": "sample", "num_inference_steps": 10,
        "augmentation_translation": 0.0, "augmentation_yaw": 0.0, "history_noise_std": 0.0,
        "clip_sample_range": 1.0, "optimizer_lr": 1e-4, "optimizer_weight_decay": 1e-6, "scheduler_warmup_steps": 500,
    },
    "paper": {
        "head": "diffusion",
        "num_points": 4096, "encoder": "pointnet2", "encoder_dims": (64, 128, 256, 512), "encoder_out_dim": 128,
        "tcp_relative": False, "proprioception": "full",
        "n_obs_steps": 4, "n_action_history_steps": 4, "horizon": 4, "n_action_steps": 2,
        "down_dims": (256, 512, 1024), "kernel_size": 5, "diffusion_step_embed_dim": 256,
        "noise_scheduler_type": "DDPM", "prediction_type": "epsilon", "num_inference_steps": 100,
        "augmentation_translation": 0.0, "augmentation_yaw": 0.0, "history_noise_std": 0.0,
        "clip_sample_range": 1.0, "optimizer_lr": 1e-4, "optimizer_weight_decay": 1e-6, "scheduler_warmup_steps": 500,
    },
}  # fmt: skip
"""``fast``: trains and acts on two CPU cores.

``dp3``: 3D Diffusion Policy (Ze et al. 2024) with the values of its release, without an action history.
``--policy.down_dims='[128,256,384]'`` gives the release's Simple DP3, which a CPU can train. Two things differ: the
state has no layers of its own, and a chunk begins at the present step, not one before.
``paper``: the paper's table of parameters, except for ``--batch_size=64``. Values missing in the table are those of the
paper's code.
"""
