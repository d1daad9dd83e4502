"""AprilGrids found in images."""
