"""Pairs, disparity maps, point clouds, and looking at them."""
