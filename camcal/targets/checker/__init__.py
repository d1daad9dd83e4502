"""Detection of chessboards and ChArUco boards."""
