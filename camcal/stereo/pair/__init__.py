"""A pair before it is matched: its rows, its order, its light and its range of disparities."""
