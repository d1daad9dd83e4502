"""Simulated raw frames of a sensor model: images of a board, flat frames, dark frames.

Light goes in and raw counts come out, with the noise that photon transfer searches for.
"""

from collections.abc import Mapping
from math import hypot, isfinite
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.raw import MONO
from camcal.raw.mosaic import require_pattern, sites
from camcal.simulate.options import Sensor
from camcal.simulate.render import Exposure, Shape, evenly_lit, light
from camcal.targets.board import Board

_COUNTED_PHOTONS = 1e9  # above that the noise is far below a count, and numpy's Poisson draws end at 9e18
PICTURE_S = 0.01  # exposure of a photograph
SATURATED_S = 0.1  # exposure at which a flat frame fills the brightest pixels
_LOWEST, _HIGHEST = 0.02, 1.25  # of saturation: the ladder ends where the darkest pixels of the weakest colour are full
_SHORT_LADDER = 4  # fewer levels stay below saturation, or none would be left to measure the gain with
_SHORT_TOP = 0.6


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


@dataclass(frozen=True)
class RawCamera:
    """A sensor behind a colour filter and a lens.

    light: what red, green and blue samples receive of the same white, as shares of saturation_e at full scale.
    aberration_px: how far red lies outside and blue inside of green at the corner of the image.
    """

    pattern: str
    sensor: Sensor = field(default_factory=Sensor)
    light: tuple[float, float, float] = (1.0, 1.0, 1.0)
    aberration_px: float = 0.0

    def __post_init__(self) -> None:
        require_pattern(self.pattern)
        if not all(isfinite(share) and share > 0 for share in self.light):
            raise InvalidInput("the light of red, green and blue must be positive")
        if self.pattern == MONO and (self.aberration_px != 0 or self.light != (1.0, 1.0, 1.0)):
            raise InvalidInput("a sensor without colour filters has no light or aberration of colours")


class Shot(NamedTuple):
    """How a flat or dark frame is taken: seconds, and its light as a share of saturation in the brightest pixels."""

    exposure_s: float
    share: float


def photograph(
    raw: RawCamera,
    camera: Camera,
    board: Board,
    camera_T_board: Pose,
    *,
    exposure: Exposure,
    shape: Shape,
    fixed: FixedPattern,
    rng: np.random.Generator,
) -> Array:
    """Return the mosaic (height, width), uint16, of a board; noise, gamma and depth of the exposure play no part.

    Every colour is rendered through its own lens, at the places where the filter has it. Raises as `render` does.
    """
    falling = light(camera.image_size, exposure, rng.uniform(0, 2 * np.pi))
    views = lenses(camera, raw.aberration_px)
    seen = {view: evenly_lit(view, board, camera_T_board, exposure, shape) * falling for view in set(views.values())}
    electrons = _behind_filter(raw, {colour: seen[view] for colour, view in views.items()})
    return expose(raw.sensor, electrons, PICTURE_S, fixed, rng)


def even_frame(
    raw: RawCamera, shot: Shot, vignetting: float, *, fixed: FixedPattern, rng: np.random.Generator
) -> Array:
    """Return the mosaic (height, width), uint16, of an evenly lit white surface, or of nothing if the share is 0.

    vignetting: by what share the light falls towards the corners.
    """
    height, width = fixed.response.shape
    falling = light((width, height), Exposure(gradient=0, vignetting=vignetting), direction=0)
    brightness = shot.share / max(raw.light) * falling
    electrons = _behind_filter(raw, dict.fromkeys("RGB", brightness))
    return expose(raw.sensor, electrons, shot.exposure_s, fixed, rng)


def exposure_series(raw: RawCamera, levels: int, vignetting: float) -> list[Shot]:
    """Return flat frames of rising exposure, from nearly dark to all pixels saturated.

    Fewer than four levels stay below saturation.
    """
    if levels < _SHORT_LADDER:
        shares = _SHORT_TOP * np.arange(1, levels + 1) / levels
    else:
        weakest = min(raw.light) / max(raw.light) * max(1 - vignetting, 0.05)
        shares = np.geomspace(_LOWEST, _HIGHEST / weakest, levels)
    exposures = [float(f"{SATURATED_S * share:.4g}") for share in shares]  # as the folders are named
    return [Shot(exposure, exposure / SATURATED_S) for exposure in exposures]


def _behind_filter(raw: RawCamera, brightness: dict[str, Array]) -> Array:
    """Return the expected electrons (H, W) in every pixel from the brightness (H, W) in each colour."""
    if raw.pattern == MONO:
        return brightness["G"] * raw.sensor.saturation_e
    shares = dict(zip("RGB", raw.light, strict=True))
    return filter_mosaic(
        raw.pattern, {colour: shares[colour] * raw.sensor.saturation_e * brightness[colour] for colour in shares}
    )


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
        raise InvalidInput(f"an aberration of {aberration_px:g} px folds the image")
    return {"R": _scale(camera, 1 + scale), "G": camera, "B": _scale(camera, 1 - scale)}


def _scale(camera: Camera, scale: float) -> Camera:
    factors = [scale if name in ("fx", "fy") else 1.0 for name in camera.model.parameter_names]
    return replace(camera, parameters=camera.parameters * factors)


def filter_mosaic(pattern: str, colours: Mapping[str, Array]) -> Array:
    """Return the mosaic (H, W) that takes every sample from the image (H, W) of its colour R, G or B."""
    mosaic = np.empty_like(next(iter(colours.values())))
    for colour, image in colours.items():
        for site in sites(pattern, colour):
            mosaic[site] = image[site]
    return mosaic
