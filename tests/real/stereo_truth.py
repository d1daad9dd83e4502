"""Real pairs and what is known of their disparities."""

import numpy as np

from camcal.formats import disparity
from camcal.images.files import gray_8bit, load

MAPS = {
    "middlebury2003-cones": ("im2.png", "im6.png", "disp2.png", 4),
    "middlebury2003-teddy": ("im2.png", "im6.png", "disp2.png", 4),
    "middlebury2001-venus": ("im2.png", "im6.png", "disp2.png", 8),
    "middlebury2014-motorcycleQ": ("im0.png", "im1.png", "disp0GT.pfm", 1),
}
STREET = ("slambook2-ch5-ch8", "ch5/stereo/left.png", "ch5/stereo/right.png")


def pair_of(data, name):
    """Return the left and the right image (H, W) uint8 of a pair."""
    folder, left, right = STREET if name == STREET[0] else (name, *MAPS[name][:2])
    return gray_8bit(load(data / "stereo_gt" / folder / left).pixels), gray_8bit(
        load(data / "stereo_gt" / folder / right).pixels
    )


def truth_of(data, name):
    """Return the known disparities (N,) of a pair, pixels."""
    _, _, file, scale = MAPS[name]
    values = disparity.read(data / "stereo_gt" / name / file, scale).values
    return values[np.isfinite(values) & (values > 0)]
