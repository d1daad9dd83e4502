"""Calibration boards, their shape, and their detection in images."""
