"""Simulated data sets with ground truth."""
