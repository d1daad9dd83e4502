"""Transforms between named frames."""
