"""The samples of an image that say where something is."""

from dataclasses import dataclass

from camcal.arrays import Array


@dataclass(frozen=True, eq=False)
class Samples:
    """Values (H, W), uint8 or any other kind of number, and the mask (H, W) of those that count, None: all.

    The samples of one colour of a mosaic are such a mask.
    """

    values: Array
    sites: Array | None = None
