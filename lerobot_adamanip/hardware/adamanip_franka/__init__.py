"""The robot `adamanip_franka` of LeRobot; LeRobot finds its class by the name of its configuration, on first use."""
