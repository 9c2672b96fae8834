"""LeRobot devices of the twin: robot, camera and scripted teleoperator. The simulator runs in another process."""
