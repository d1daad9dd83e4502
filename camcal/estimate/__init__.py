"""Poses and states from measurements."""
