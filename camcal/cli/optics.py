"""`camcal optics`."""


def optics() -> None:
    """Work out lenses: field of view, focus, blur, and what a pixel sees."""
