"""Disparity against what is known to be true."""
