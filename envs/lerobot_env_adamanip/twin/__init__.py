"""The twin's robot, camera and scripted teleoperator as LeRobot sees them; the simulator is in another process."""
