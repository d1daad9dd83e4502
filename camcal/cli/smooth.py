"""`camcal smooth`."""


def smooth() -> None:
    """Smooth what was measured over time, and say how well it is known."""
