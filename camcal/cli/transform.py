"""`camcal transform`."""


def chain() -> None:
    """Compose named transforms, and refuse those whose frames do not meet."""
