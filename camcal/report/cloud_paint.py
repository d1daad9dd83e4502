"""The colour of every point of a cloud, and what it stands for."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.report.cloud_scene import CloudScene
from camcal.report.colour_scale import ColourScale, scale_of, turbo

COLOURS = ("image", "depth", "sigma", "gray")

_PLAIN = 150  # gray level of points that have no colour
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # Rec. ITU-R BT.601


@dataclass(frozen=True, eq=False)
class Paint:
    """The colour of every point (N, 3), red, green, blue, uint8, and the scale it stands for, if it stands for one."""

    colours: Array
    name: str
    scale: ColourScale | None = None


def paint_of(scene: CloudScene, colour: str | None = None) -> Paint:
    """Return the colours of the points by image, depth, sigma or gray; by default by image, or depth without one.

    Raises InvalidInput if the cloud does not have what it is to be coloured by.
    """
    colour = colour or ("depth" if scene.colours is None else "image")
    if colour not in COLOURS:
        raise InvalidInput(f"colour {colour!r} is unknown; use one of {', '.join(COLOURS)}")
    if colour == "depth":
        return _scaled(scene.depth, colour)
    if colour == "sigma":
        if scene.sigma is None:
            raise InvalidInput("the cloud has no sigma to be coloured by; 'camcal stereo cloud --sigma' writes it")
        return _scaled(scene.sigma, colour)
    if colour == "image":
        if scene.colours is None:
            raise InvalidInput("the cloud has no colours; use depth or gray")
        return Paint(scene.colours, colour)
    if scene.colours is None:
        return Paint(np.full(scene.points.shape, _PLAIN, np.uint8), colour)
    light = np.rint(scene.colours @ _LUMA).astype(np.uint8)
    return Paint(np.repeat(light[:, None], 3, axis=1), colour)


def _scaled(values: Array, name: str) -> Paint:
    scale = scale_of(values)
    return Paint(turbo(scale.fraction(values)), name, scale)
