"""Grids of circles found and measured in images."""
