"""The figures of a lens, each computed if its inputs are known, in SI units."""

from collections.abc import Collection
from math import pi

import numpy as np

from camcal import optics
from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import field_of_view, field_size, pixel_angles, pixel_sizes
from camcal.dataclass import dataclass, field
from camcal.records import entry
from camcal.tasks.lenses.optics_setup import Setup


@dataclass(frozen=True)
class FieldOfView:
    """The angles (rad) that the image sees: through the rays of a camera file, else of the thin lens."""

    horizontal: float = field(metadata=entry("horizontal_deg", 180 / pi, "field of view, horizontal", "deg"))
    vertical: float = field(metadata=entry("vertical_deg", 180 / pi, "field of view, vertical", "deg"))
    diagonal: float = field(metadata=entry("diagonal_deg", 180 / pi, "field of view, diagonal", "deg"))


@dataclass(frozen=True)
class PixelAngle:
    """The angle (rad) that a pixel sees in the middle of the image and at the corner farthest from the axis."""

    centre: float = field(metadata=entry("centre_deg", 180 / pi, "angle of a pixel at the centre", "deg"))
    corner: float = field(metadata=entry("corner_deg", 180 / pi, "angle of a pixel at the corner", "deg"))


@dataclass(frozen=True)
class Focus:
    """Lengths (m) of the sharp image and of what is sharp around the focus."""

    principal_distance: float = field(metadata=entry("principal_distance_mm", 1e3, "principal distance", "mm"))
    magnification: float = field(metadata=entry("magnification", 1.0, "magnification", ""))
    hyperfocal: float | None = field(metadata=entry("hyperfocal_m", 1.0, "hyperfocal distance", "m"))
    near: float | None = field(metadata=entry("near_m", 1.0, "in focus from", "m"))
    far: float | None = field(metadata=entry("far_m", 1.0, "in focus up to", "m"))
    depth_of_field: float | None = field(metadata=entry("depth_of_field_m", 1.0, "depth of field", "m"))


@dataclass(frozen=True)
class Diffraction:
    """The Airy disc (m, px), the contrast left at half a cycle a pixel, and the f-number with a disc of two pixels.

    All but its size in metres are None without a pitch.
    """

    airy_diameter: float = field(metadata=entry("airy_diameter_um", 1e6, "Airy disc", "um"))
    airy_px: float | None = field(default=None, metadata=entry("airy_px", 1.0, "Airy disc", "px"))
    contrast: float | None = field(default=None, metadata=entry("contrast", 1.0, "diffraction MTF at Nyquist", ""))
    sharp_f_number: float | None = field(
        default=None, metadata=entry("sharp_f_number", 1.0, "f-number with an Airy disc of 2 px", "")
    )

    @property
    def limited(self) -> bool:
        """Whether the lens, not the pixels, limits how fine a detail is."""
        return self.airy_px is not None and self.airy_px > optics.AIRY_PIXELS


@dataclass(frozen=True)
class Exposure:
    """The f-number that light has at close focus, the stops this costs, and the exposure value at ISO 100."""

    effective_f_number: float = field(metadata=entry("effective_f_number", 1.0, "effective f-number", ""))
    close_focus_stops: float = field(metadata=entry("close_focus_stops", 1.0, "light loss by close focus", "stops"))
    exposure_value: float | None = field(metadata=entry("exposure_value", 1.0, "exposure value, ISO 100", "EV"))


@dataclass(frozen=True)
class ImageCircle:
    """The circle (m) that the lens lights, and the one that the sensor needs around the axis."""

    given: float = field(metadata=entry("given_mm", 1e3, "image circle", "mm"))
    needed: float = field(metadata=entry("needed_mm", 1e3, "image circle that the sensor needs", "mm"))


@dataclass(frozen=True)
class AtDistance:
    """What the image shows at one distance (m); None is unknown.

    width, height: of the field, m. pixel, corner_pixel: sizes of a pixel on a plane there, m. line_pairs: that
    pixels resolve in a metre. blur_px: the defocus disc. motion_px: blur by motion. longest_exposure: for 1 px of it,
    s. exposure_stops: of light between the exposure and that one. disparity_px, depth_error: of a stereo pair, px, m.
    """

    distance: float = field(metadata=entry("distance_m", 1.0, "distance", "m"))
    width: float | None = field(default=None, metadata=entry("width_m", 1.0, "width of the field", "m"))
    height: float | None = field(default=None, metadata=entry("height_m", 1.0, "height of the field", "m"))
    pixel: float | None = field(default=None, metadata=entry("pixel_mm", 1e3, "a pixel at the centre", "mm"))
    corner_pixel: float | None = field(
        default=None, metadata=entry("corner_pixel_mm", 1e3, "a pixel at the corner", "mm")
    )
    line_pairs: float | None = field(default=None, metadata=entry("line_pairs_per_mm", 1e-3, "line pairs", "1/mm"))
    blur_px: float | None = field(default=None, metadata=entry("blur_px", 1.0, "blur by defocus", "px"))
    motion_px: float | None = field(default=None, metadata=entry("motion_px", 1.0, "blur by motion", "px"))
    longest_exposure: float | None = field(
        default=None, metadata=entry("longest_exposure_ms", 1e3, "exposure for 1 px of motion", "ms")
    )
    exposure_stops: float | None = field(
        default=None, metadata=entry("exposure_stops", 1.0, "light lost by it", "stops")
    )
    disparity_px: float | None = field(default=None, metadata=entry("disparity_px", 1.0, "disparity", "px"))
    depth_error: float | None = field(default=None, metadata=entry("depth_error_mm", 1e3, "depth, ±", "mm"))


def angles_of_view(setup: Setup) -> FieldOfView | None:
    """Return the field of view: to the outer edges of the image, or to its circle; None without a lens and a sensor."""
    if setup.measured and setup.camera is not None:
        return FieldOfView(*field_of_view(setup.camera, setup.lit))
    distance, sides = setup.principal_distance, setup.sensor
    if distance is None or sides is None:
        return None
    return FieldOfView(*(optics.field_angle(length, distance) for length in (*sides, float(np.hypot(*sides)))))


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
    found = optics.principal_distance(focal, distance), optics.magnification(focal, distance)
    if number is None or circle is None:
        return Focus(*found, None, None, None, None)
    near, far = optics.depth_of_field(focal, number, circle, distance)
    return Focus(*found, optics.hyperfocal(focal, number, circle), near, far, far - near)


def diffraction(setup: Setup) -> Diffraction | None:
    """Return what diffraction leaves of an image in focus, None without an f-number."""
    number, pitch, wavelength = setup.effective_f_number, setup.pitch, setup.options.wavelength
    if number is None:
        return None
    disc = optics.airy_diameter(wavelength, number)
    if pitch is None:
        return Diffraction(disc)
    contrast = optics.diffraction_contrast(wavelength, number, pitch)
    return Diffraction(disc, disc / pitch, contrast, optics.widest_sharp_f_number(wavelength, pitch))


def exposure(setup: Setup) -> Exposure | None:
    """Return how bright the image is, None without an f-number."""
    number, effective, time = setup.options.f_number, setup.effective_f_number, setup.options.exposure
    if number is None or effective is None:
        return None
    value = None if time is None else optics.exposure_value(number, time)
    return Exposure(effective, optics.bellows_stops(setup.magnification or 0.0), value)


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
    return float(optics.blur_disc(focal, number, focused, distance)) / pitch


def _motion(setup: Setup, pixel: float | None) -> tuple[float | None, float | None, float | None]:
    speed, time = setup.options.speed, setup.options.exposure
    if speed is None or pixel is None:
        return None, None, None
    longest = optics.longest_exposure(speed, 1.0, pixel)
    if time is None:
        return None, longest, None
    return optics.motion_blur(speed, time, pixel), longest, optics.stops_between(time, longest)


def _stereo(setup: Setup, distance: float) -> tuple[float | None, float | None]:
    baseline = setup.options.baseline
    if baseline is None or setup.camera is None:
        return None, None
    fx = setup.camera.value("fx")
    return fx * baseline / distance, optics.depth_error(distance, fx, baseline, setup.options.disparity_noise)


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
