"""Rendered data with known truth."""
