"""Tracking of poses over time: filtering, smoothing, consistency checks."""
