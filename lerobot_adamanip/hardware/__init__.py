"""A real Franka, its twin, depth cameras and teleoperators, as devices of LeRobot; drivers load on first use."""
