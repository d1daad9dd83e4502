"""A sensor whose figures are known: light in, raw counts out, with the noise that photon transfer looks for."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.raw.mosaic import sites
from camcal.simulate.options import Sensor

_COUNTED_PHOTONS = 1e9  # above that the noise is far below a count, and numpy's Poisson draws end at 9e18


@dataclass(frozen=True, eq=False)
class FixedPattern:
    """What stays the same from frame to frame: response (H, W), 1 on average, and dark offset (H, W) in electrons."""

    response: Array
    offset_e: Array

    @classmethod
    def of(cls, sensor: Sensor, size: tuple[int, int], rng: np.random.Generator) -> "FixedPattern":
        """Return a pattern for a sensor of `size` (width, height)."""
        response, offset = rng.standard_normal((2, size[1], size[0]))
        return cls(1 + sensor.prnu * response, sensor.dsnu_e * offset)


def expose(sensor: Sensor, light_e: Array, exposure_s: float, pattern: FixedPattern, rng: np.random.Generator) -> Array:
    """Return the counts (H, W), uint16, of one frame.

    light_e: (H, W) electrons that the light makes on average in a pixel of response 1, during all of the exposure.
    """
    expected = np.clip(light_e * pattern.response, 0, _COUNTED_PHOTONS) + sensor.dark_current_e_s * exposure_s
    collected = np.minimum(rng.poisson(expected), sensor.full_well_e)
    read = collected + pattern.offset_e + sensor.read_noise_e * rng.standard_normal(expected.shape)
    counts = np.rint(sensor.black_dn + sensor.gain_dn_per_e * read)
    return np.asarray(np.clip(counts, 0, sensor.white_dn), dtype=np.uint16)


def lenses(camera: Camera, aberration_px: float) -> dict[str, Camera]:
    """Return the camera of each colour R, G, B of a lens with lateral chromatic aberration.

    The red image is larger and the blue one smaller than the green one about the principal point, so that they are off
    by aberration_px at the corner of the image that is furthest from it. Every model has its focal lengths as factors
    of the image, so this is exact.
    """
    if aberration_px == 0:
        return dict.fromkeys("RGB", camera)
    x, y = camera.value("cx"), camera.value("cy")
    width, height = camera.image_size
    scale = aberration_px / hypot(max(x, width - 1 - x), max(y, height - 1 - y))
    if not abs(scale) < 1:
        raise InvalidInput(f"an aberration of {aberration_px:g} px turns the image over")
    return {"R": _scaled(camera, 1 + scale), "G": camera, "B": _scaled(camera, 1 - scale)}


def _scaled(camera: Camera, scale: float) -> Camera:
    factors = [scale if name in ("fx", "fy") else 1.0 for name in camera.model.parameter_names]
    return replace(camera, parameters=camera.parameters * factors)


def filtered(pattern: str, colours: Mapping[str, Array]) -> Array:
    """Return the mosaic (H, W) that takes every sample from the image (H, W) of its colour R, G or B."""
    mosaic = np.empty_like(next(iter(colours.values())))
    for colour, image in colours.items():
        for site in sites(pattern, colour):
            mosaic[site] = image[site]
    return mosaic
