"""States over time from what was measured: filters, smoothers, and whether to believe them."""
