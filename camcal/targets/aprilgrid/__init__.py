"""Detection of AprilGrids."""
