"""Where things are and where they go: single poses, tracks, series over time."""
