"""The figures of a lens, each computed if its inputs are known, in SI units."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import field_of_view, field_size, pixel_angles, pixel_sizes
from camcal.optics import lens
from camcal.tasks.lenses.optics_setup import Setup


@dataclass(frozen=True)
class FieldOfView:
    """The angles (rad) that the image sees: through the rays of a camera file, else of the thin lens."""

    horizontal: float
    vertical: float
    diagonal: float


@dataclass(frozen=True)
class PixelAngle:
    """The angle (rad) that a pixel sees in the middle of the image and at the corner farthest from the axis."""

    centre: float
    corner: float


@dataclass(frozen=True)
class Focus:
    """Lengths (m) of the sharp image and of what is sharp around the focus."""

    principal_distance: float
    magnification: float
    hyperfocal: float | None
    near: float | None
    far: float | None
    depth_of_field: float | None


@dataclass(frozen=True)
class Diffraction:
    """The Airy disc (m, px), the contrast left at half a cycle a pixel, and the f-number with a disc of two pixels.

    All but its size in metres are None without a pitch.
    """

    airy_diameter: float
    airy_px: float | None = None
    contrast: float | None = None
    sharp_f_number: float | None = None

    @property
    def limited(self) -> bool:
        """Whether the lens, not the pixels, limits how fine a detail is."""
        return self.airy_px is not None and self.airy_px > lens.AIRY_PIXELS


@dataclass(frozen=True)
class Exposure:
    """The f-number that light has at close focus, the stops this costs, and the exposure value at ISO 100."""

    effective_f_number: float
    close_focus_stops: float
    exposure_value: float | None


@dataclass(frozen=True)
class ImageCircle:
    """The circle (m) that the lens lights, and the one that the sensor needs around the axis."""

    given: float
    needed: float


@dataclass(frozen=True)
class AtDistance:
    """What the image shows at one distance (m); None is unknown.

    width, height: of the field, m. pixel, corner_pixel: sizes of a pixel on a plane there, m. line_pairs: that
    pixels resolve in a metre. blur_px: the defocus disc. motion_px: blur by motion. longest_exposure: for 1 px of it,
    s. exposure_stops: of light between the exposure and that one. disparity_px, depth_error: of a stereo pair, px, m.
    """

    distance: float
    width: float | None = None
    height: float | None = None
    pixel: float | None = None
    corner_pixel: float | None = None
    line_pairs: float | None = None
    blur_px: float | None = None
    motion_px: float | None = None
    longest_exposure: float | None = None
    exposure_stops: float | None = None
    disparity_px: float | None = None
    depth_error: float | None = None


def field(setup: Setup) -> FieldOfView | None:
    """Return the field of view: to the outer edges of the image, or to its circle; None without a lens and a sensor."""
    if setup.measured and setup.camera is not None:
        return FieldOfView(*field_of_view(setup.camera, setup.lit))
    distance, sides = setup.principal_distance, setup.sensor
    if distance is None or sides is None:
        return None
    return FieldOfView(*(lens.field_angle(length, distance) for length in (*sides, float(np.hypot(*sides)))))


def pixel_angle(setup: Setup) -> PixelAngle | None:
    """Return the angles of pixels, None without lens, pitch and size."""
    if setup.camera is None:
        return None
    centre, corner = pixel_angles(setup.camera, _probes(setup.camera)).tolist()
    return PixelAngle(centre, corner)


def _probes(camera: Camera) -> Array:
    """Return the pixels (2, 2) in the middle of the image and in the corner farthest from the axis."""
    width, height = camera.image_size
    corner = [
        last if last - value > value else 0
        for value, last in ((camera.value("cx"), width - 1), (camera.value("cy"), height - 1))
    ]
    return np.array([[(width - 1) / 2, (height - 1) / 2], corner], dtype=float)


def focus(setup: Setup) -> Focus | None:
    """Return what follows from a focus; depth of field and hyperfocal are None without f-number and circle."""
    focal, distance, number, circle = setup.focal, setup.focus, setup.options.f_number, setup.circle
    if focal is None or distance is None:
        return None
    sharp = None if number is None or circle is None else lens.depth_of_field(focal, number, circle, distance)
    return Focus(
        lens.principal_distance(focal, distance),
        lens.magnification(focal, distance),
        None if number is None or circle is None else lens.hyperfocal(focal, number, circle),
        *((None, None, None) if sharp is None else (sharp.near, sharp.far, sharp.total)),
    )


def diffraction(setup: Setup) -> Diffraction | None:
    """Return what diffraction leaves of an image in focus, None without an f-number."""
    number, pitch, wavelength = setup.effective_f_number, setup.pitch, setup.options.wavelength
    if number is None:
        return None
    disc = lens.airy_diameter(wavelength, number)
    if pitch is None:
        return Diffraction(disc)
    contrast = lens.diffraction_contrast(wavelength, number, pitch)
    return Diffraction(disc, disc / pitch, contrast, lens.widest_sharp_f_number(wavelength, pitch))


def exposure(setup: Setup) -> Exposure | None:
    """Return how bright the image is, None without an f-number."""
    number, effective, time = setup.options.f_number, setup.effective_f_number, setup.options.exposure
    if number is None or effective is None:
        return None
    value = None if time is None else lens.exposure_value(number, time)
    return Exposure(effective, lens.bellows_stops(setup.magnification or 0.0), value)


def image_circle(setup: Setup) -> ImageCircle | None:
    """Return the circle that is lit beside the one that is needed, None if one of them is not known."""
    given = setup.options.image_circle
    if given is None or setup.sensor is None:
        return None
    return ImageCircle(given, _needed_circle(setup) or float(np.hypot(*setup.sensor)))


def _needed_circle(setup: Setup) -> float | None:
    """Return the circle (m) around a measured principal point; the others' is in the middle."""
    if not setup.measured or setup.camera is None or setup.pitch is None:
        return None
    width, height = setup.camera.image_size
    cx, cy = setup.camera.value("cx"), setup.camera.value("cy")
    reach = max(cx + 0.5, width - 0.5 - cx), max(cy + 0.5, height - 0.5 - cy)
    return 2 * setup.pitch * float(np.hypot(*reach))


def at_distance(setup: Setup, distance: float) -> AtDistance:
    """Return what is known of the image of things at a distance (m) along the axis."""
    width, height = _field_size(setup, distance)
    pixel, corner = _pixel_sizes(setup, distance)
    disparity, error = _stereo(setup, distance)
    motion, longest, stops = _motion(setup, pixel)
    return AtDistance(
        distance=distance,
        width=width,
        height=height,
        pixel=pixel,
        corner_pixel=corner,
        line_pairs=None if pixel is None else 1 / (2 * pixel),
        blur_px=_blur_px(setup, distance),
        motion_px=motion,
        longest_exposure=longest,
        exposure_stops=stops,
        disparity_px=disparity,
        depth_error=error,
    )


def _field_size(setup: Setup, distance: float) -> tuple[float | None, float | None]:
    if setup.camera is not None:
        return field_size(setup.camera, distance, setup.lit)
    principal, sides = setup.principal_distance, setup.sensor
    if principal is None or sides is None:
        return None, None
    return sides[0] * distance / principal, sides[1] * distance / principal


def _pixel_sizes(setup: Setup, distance: float) -> tuple[float | None, float | None]:
    if setup.camera is not None:
        centre, corner = pixel_sizes(setup.camera, _probes(setup.camera), distance).tolist()
        return centre, corner if setup.measured else None  # a pinhole shows a plane evenly
    principal, pitch = setup.principal_distance, setup.pitch
    if principal is None or pitch is None:
        return None, None
    return distance * pitch / principal, None


def _blur_px(setup: Setup, distance: float) -> float | None:
    focal, focused, number, pitch = setup.focal, setup.focus, setup.options.f_number, setup.pitch
    if focal is None or focused is None or number is None or pitch is None:
        return None
    return float(lens.blur_disc(focal, number, focused, distance)) / pitch


def _motion(setup: Setup, pixel: float | None) -> tuple[float | None, float | None, float | None]:
    speed, time = setup.options.speed, setup.options.exposure
    if speed is None or pixel is None:
        return None, None, None
    longest = lens.longest_exposure(speed, 1.0, pixel)
    if time is None:
        return None, longest, None
    return lens.motion_blur(speed, time, pixel), longest, lens.stops_between(time, longest)


def _stereo(setup: Setup, distance: float) -> tuple[float | None, float | None]:
    baseline = setup.options.baseline
    if baseline is None or setup.camera is None:
        return None, None
    fx = setup.camera.value("fx")
    return fx * baseline / distance, lens.depth_error(distance, fx, baseline, setup.options.disparity_noise)


def missing(setup: Setup) -> dict[str, str]:
    """Return every figure that cannot be computed with the options that it still needs."""
    lacking = {
        figure: _lacking(setup, set(needed) - _LENS if setup.measured and figure in _BY_RAYS else set(needed))
        for figure, needed in _NEEDS.items()
    }
    return {figure: " and ".join(options) for figure, options in lacking.items() if options}


def _lacking(setup: Setup, needed: Collection[str]) -> list[str]:
    known = vars(setup.options) | {name: getattr(setup, name) for name in _RESOLVED}
    options = dict(_OPTIONS)
    if setup.measured:
        options["focal"] = "--pitch-um (or --focal)"
    if setup.size is not None:
        options["sensor"] = options["pitch"] = "--pitch-um (or --sensor)"
    elif setup.sensor is not None:
        options["pitch"] = options["size"]
    return list(dict.fromkeys(options[name] for name in options if name in needed and known[name] is None))


_RESOLVED = ("focal", "focus", "sensor", "pitch", "size", "circle")
_LENS = {"focal", "sensor", "pitch", "size"}  # what the rays of a camera file stand for
_BY_RAYS = {"field of view", "angle of a pixel", "motion blur", "stereo depth"}
_OPTIONS = {
    "focal": "--focal",
    "focus": "--focus",
    "sensor": "--sensor (or --pitch-um and --size)",
    "pitch": "--pitch-um (or --sensor and --size)",
    "size": "--size",
    "circle": "--coc (or the pitch)",
    "f_number": "--f-number",
    "exposure": "--exposure",
    "speed": "--speed",
    "baseline": "--baseline",
    "image_circle": "--image-circle",
}
_NEEDS = {
    "field of view": ("focal", "sensor"),
    "angle of a pixel": ("focal", "pitch", "size"),
    "depth of field": ("focal", "focus", "f_number", "circle"),
    "diffraction in pixels": ("f_number", "pitch"),
    "exposure value": ("f_number", "exposure"),
    "motion blur": ("speed", "exposure", "focal", "pitch"),
    "stereo depth": ("baseline", "focal", "pitch", "size"),
    "image circle": ("image_circle", "sensor"),
}
