"""Corners where two edges cross, measured as exactly as an image allows."""
