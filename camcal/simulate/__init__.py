"""Rendered data with ground truth."""
