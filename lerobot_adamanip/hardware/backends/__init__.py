"""Backends (`arm.ArmBackend`) of real arms. The twin's backend is `lerobot_env_adamanip.sim.twin`."""
