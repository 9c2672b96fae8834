"""Read, check, repair, edit, count, view and describe LeRobotDatasets of this project."""
