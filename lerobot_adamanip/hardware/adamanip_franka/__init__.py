"""The robot `adamanip_franka`. LeRobot imports its class on first use, by the name of its configuration."""
