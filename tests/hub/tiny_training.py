"""Options of lerobot-train."""

TINY = (
    "--policy.type=dp3_adaptive", "--policy.num_points=8", "--policy.encoder_dims=[16,16]",
    "--policy.encoder_out_dim=16", "--policy.device=cpu", "--env.type=adamanip_safe", "--env.num_points=8",
    "--env_eval_freq=0", "--batch_size=2",
    "--num_workers=0", "--steps=3", "--save_freq=3",
)  # fmt: skip
"""Options of the smallest training."""
