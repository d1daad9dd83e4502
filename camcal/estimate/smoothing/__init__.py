"""State estimation over time: filters, smoothers, and consistency checks."""
