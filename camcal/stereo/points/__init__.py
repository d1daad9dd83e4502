"""Point clouds from disparity."""
