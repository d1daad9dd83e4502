"""Lens models and cameras."""
