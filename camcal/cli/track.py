"""`camcal track`."""


def track() -> None:
    """Follow poses over a video, a folder of images or a file of poses."""
