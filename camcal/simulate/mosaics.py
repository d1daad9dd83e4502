"""Raw frames of a known sensor: photographs of a board, evenly lit flat frames, dark frames."""

from dataclasses import dataclass, field
from math import isfinite
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.raw.mosaic import require_pattern
from camcal.raw.options import MONO
from camcal.simulate.options import Sensor
from camcal.simulate.render import Exposure, evenly_lit, light
from camcal.simulate.sensor import FixedPattern, expose, filtered, lenses
from camcal.simulate.shapes import Shape
from camcal.targets.board import Board

PICTURE_S = 0.01  # exposure of a photograph
SATURATED_S = 0.1  # exposure at which a flat frame fills the brightest pixels

_LOWEST, _HIGHEST = 0.02, 1.25  # of saturation: the ladder ends where the darkest pixels of the weakest colour are full
_SHORT_LADDER = 4  # fewer levels stay below saturation, or none would be left to measure the gain with
_SHORT_TOP = 0.6


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
            raise InvalidInput("the light of red, green and blue is above 0")
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


def ladder(raw: RawCamera, levels: int, vignetting: float) -> list[Shot]:
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
    return filtered(
        raw.pattern, {colour: shares[colour] * raw.sensor.saturation_e * brightness[colour] for colour in shares}
    )
