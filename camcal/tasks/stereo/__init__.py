"""Stereo pairs, disparity maps, point clouds, and their views."""
