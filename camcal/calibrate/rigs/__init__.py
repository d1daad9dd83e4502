"""Calibration of several cameras from captures of a board."""
