"""Detection and measurement of grids of circles."""
