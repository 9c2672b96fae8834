"""Reading, checking, repairing, editing, counting, viewing and describing this project's LeRobotDatasets."""
