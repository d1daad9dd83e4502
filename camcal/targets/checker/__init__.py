"""Chessboards and ChArUco boards found in images."""
