"""Rectification, disparity and point clouds."""
