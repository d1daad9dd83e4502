"""Poses followed over time: filtered, smoothed, and judged."""
