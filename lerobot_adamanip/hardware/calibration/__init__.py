"""Where a camera is and how it sees: found by a board in the robot's hand or beside it, kept in a file."""
