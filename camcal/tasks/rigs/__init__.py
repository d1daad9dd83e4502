"""Calibration of rigs: which images belong together, the solve, the rig file."""
