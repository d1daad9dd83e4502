"""Calibration from images of boards, and undistortion."""
