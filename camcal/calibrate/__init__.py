"""Cameras from board observations."""
