"""`camcal fit`."""


def fit() -> None:
    """Fit a curve to data, with intervals and a verdict."""
