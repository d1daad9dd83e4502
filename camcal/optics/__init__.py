"""Lenses and sensors by formulas of the thin lens: what is in focus, how large, how sharp, how bright."""
