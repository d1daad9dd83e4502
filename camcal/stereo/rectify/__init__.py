"""Rectification: the geometry of the rectified pair, and maps that images are drawn through."""
