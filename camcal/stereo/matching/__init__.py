"""Matching of rectified images: disparity of every pixel."""
