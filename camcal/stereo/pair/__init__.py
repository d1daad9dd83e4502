"""Checks of a pair before matching: rows, order, exposure and range of disparities."""
