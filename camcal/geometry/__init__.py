"""Rotations, rigid poses and triangulation, on plain arrays."""
