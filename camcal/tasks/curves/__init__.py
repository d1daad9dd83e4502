"""Curves through data."""
