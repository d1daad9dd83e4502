"""Curves fitted to data: formulas, families with starts of their own, fits, intervals and comparisons."""
