"""Poses: single poses, tracks, series over time."""
