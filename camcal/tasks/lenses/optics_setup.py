"""Known quantities of a lens, its sensor and its use: given, from a camera file, or derived."""

import re
from collections.abc import Mapping
from functools import cached_property
from math import inf, isfinite

from camcal import optics
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, field_size
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.formats import cameras, split_address
from camcal.messages import Message
from camcal.optics import SensorFormat, effective_f_number, pixel_pitch, sensor_format
from camcal.records import entry
from camcal.tasks.given_camera import read_camera_file
from camcal.tasks.lenses.options import OpticsOptions, is_possible
from camcal.tasks.options import GivenCamera

_DISAGREE = 0.05  # of two ways to the same length: more than lenses and data sheets are off
_FILE, _SOLVER = "camera file", "--solve"
_NUMBER = r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)"
_MILLIMETRES = re.compile(rf"{_NUMBER} ?[x×] ?{_NUMBER}(?: ?mm)?")
_CIRCLE = re.compile(rf"{_NUMBER} ?(um|µm|mm|px)")
_METRES = {"um": 1e-6, "µm": 1e-6, "mm": 1e-3}
# what --solve finds: the option that would say it, and its name in a setup
_SOLVED = {"f": ("--focal", "focal"), "wd": ("--focus", "focus"), "sensor": ("--sensor", "sensor")}
_SOLVE_FROM = {"focal": "--focal", "focus": "--focus", "sensor": "--sensor (or --pitch-um and --size)"}


@dataclass(frozen=True, eq=False)
class Setup:
    """A lens, its sensor and its use; what is None cannot be known from what was given. Lengths in metres.

    camera: of a file if `measured`, else a pinhole that follows from the rest. lit: the file's image circle, px.
    sensor: width and height. solved: the length that --solve asked for. sources: where the numbers of that name come
    from, if not from options.
    warnings: about the camera file, and where options disagree.
    """

    options: OpticsOptions
    camera: Camera | None = None
    measured: bool = False
    lit: ImageCircle | None = None
    focal: float | None = field(default=None, metadata=entry("focal_mm", 1e3, "focal length", "mm"))
    focus: float | None = field(default=None, metadata=entry("focus_m", 1.0, "focus", "m"))
    sensor: tuple[float, float] | None = None
    pitch: float | None = field(default=None, metadata=entry("pixel_pitch_um", 1e6, "pixel pitch", "um"))
    size: tuple[int, int] | None = None
    circle: float | None = field(
        default=None, metadata=entry("circle_of_confusion_um", 1e6, "circle of confusion", "um")
    )
    solved: float | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[Message, ...] = ()

    @cached_property
    def principal_distance(self) -> float | None:
        """From the rear principal plane to the sensor, m; for a lens without a known focus that of infinity."""
        if self.measured and self.camera is not None and self.pitch is not None:
            return self.camera.value("fx") * self.pitch
        return None if self.focal is None else optics.principal_distance(self.focal, self.focus or inf)

    @property
    def magnification(self) -> float | None:
        """The size of the image over that of the object in focus; None without a focus."""
        if self.focal is None or self.focus is None:
            return None
        return optics.magnification(self.focal, self.focus)

    @property
    def effective_f_number(self) -> float | None:
        """The f-number that light has on the sensor, N (1 + m); that of infinity without a focus."""
        number = self.options.f_number
        return None if number is None else effective_f_number(number, self.magnification or 0.0)


def set_up(options: OpticsOptions) -> Setup:
    """Return all that follows from the options.

    Raises InvalidInput for options that contradict each other or say too little for --solve, FileError for a camera
    file that cannot be read.
    """
    setup = Setup(options, focal=options.focal, focus=options.focus, pitch=options.pitch, size=options.size)
    if options.camera is not None:
        setup = _with_camera(setup, options.camera)
    setup = _with_sensor(setup)
    if options.solve is not None:
        setup = _solve(setup)
    return _with_circle(_with_pinhole(_with_focal(setup)))


def _with_camera(setup: Setup, address: str) -> Setup:
    path, fragment = split_address(address)
    file = read_camera_file(address, GivenCamera(part=setup.options.part), size_of_images=lambda: setup.size)
    entry = cameras.select(file, fragment or setup.options.name, str(path))
    size = entry.camera.image_size
    if setup.size not in (None, size):
        raise InvalidInput(f"--size: the camera file is for {size[0]}x{size[1]} images; leave it out")
    pitch, sources = setup.pitch, {"size": _FILE}
    if pitch is None and "pixel_pitch_um" in entry.sensor:
        pitch, sources["pitch"] = 1e-6 * entry.sensor["pixel_pitch_um"], _FILE
    return replace(
        setup,
        camera=entry.camera,
        measured=True,
        lit=entry.image_circle,
        size=size,
        pitch=pitch,
        sources=sources,
        warnings=file.warnings,
    )


def _with_sensor(setup: Setup) -> Setup:
    """Return the setup with the sensor's sides and the pitch, as far as its name and its pixels tell them."""
    text, size = setup.options.sensor, setup.size
    sources, warnings = dict(setup.sources), setup.warnings
    sides, pitch = None, setup.pitch
    if text is not None:
        known, nominal = _sensor(text)
        sides, warnings = (1e-3 * known.width_mm, 1e-3 * known.height_mm), (*warnings, *nominal)
        if size is not None and setup.options.pitch is None:
            pitch, sources["pitch"] = pixel_pitch(known, size), "diagonal of the sensor over that of the image"
    if size is not None and pitch is not None:
        counted = (size[0] * pitch, size[1] * pitch)
        warnings = (*warnings, *_disagreement(sides, counted, str(text)))
        sides, sources["sensor"] = counted, "pixels times pitch"
    return replace(setup, sensor=sides, pitch=pitch, sources=sources, warnings=warnings)


def _sensor(text: str) -> tuple[SensorFormat, tuple[Message, ...]]:
    """Return a sensor from the name of its format or from WxH in mm, and the warning about a name."""
    match = _MILLIMETRES.fullmatch(text.strip())
    if match and is_possible(float(match[1])) and is_possible(float(match[2])):
        return SensorFormat(text, float(match[1]), float(match[2])), ()
    known = sensor_format(text)
    words = f"sensor format {known.name} is nominal, diagonal about {known.diagonal_mm:.2f} mm: --pitch-um is exact"
    return known, (Message("nominal_sensor_format", words, {"diagonal_mm": known.diagonal_mm}, "--sensor"),)


def _disagreement(sides: tuple[float, float] | None, counted: tuple[float, float], text: str) -> list[Message]:
    if sides is None or all(abs(a / b - 1) <= _DISAGREE for a, b in zip(sides, counted, strict=True)):
        return []
    found, named = (f"{1e3 * width:.2f} x {1e3 * height:.2f} mm" for width, height in (counted, sides))
    words = f"sensor size {found} by pixels and pitch, {named} by --sensor {text}: the former is used"
    return [Message("sensor_size_differs", words, where="--sensor")]


def _solve(setup: Setup) -> Setup:
    """Return the setup with what makes the wanted width fill the image."""
    wanted, width = setup.options.solve, setup.options.width or 0.0
    option, known = _SOLVED[str(wanted)]
    if getattr(setup, known) is not None or (setup.measured and wanted != "wd"):
        raise InvalidInput(f"--solve {wanted} solves for {option}{' or the camera file' * setup.measured}")
    if setup.measured and setup.camera is not None:
        across = field_size(setup.camera, 1.0, setup.lit)[0]
        if not isfinite(across):
            raise InvalidInput("--solve wd: field of view of 180° or more, no width fills the image")
        return _at_focus(setup, width / across)
    missing = [words for name, words in _SOLVE_FROM.items() if name != known and getattr(setup, name) is None]
    if missing:
        raise InvalidInput(f"--solve {wanted} needs {' and '.join(missing)} too")
    focal, focus, side = setup.focal or 0.0, setup.focus or 0.0, setup.sensor[0] if setup.sensor else 0.0
    if wanted == "f":
        focal = optics.focal_for_width(side, focus, width)
        return replace(setup, focal=focal, solved=focal, sources={**setup.sources, "focal": _SOLVER})
    if wanted == "wd":
        return _at_focus(setup, optics.focus_for_width(focal, side, width))
    return _with_solved_sensor(setup, optics.sensor_for_width(focal, focus, width))


def _at_focus(setup: Setup, distance: float) -> Setup:
    return replace(setup, focus=distance, solved=distance, sources={**setup.sources, "focus": _SOLVER})


def _with_solved_sensor(setup: Setup, width: float) -> Setup:
    """Return the setup with a sensor of that width: the aspect and the pitch of the image, else 4:3."""
    across, down = setup.size or (4, 3)
    pitch = width / across if setup.size else None
    sides = (width, width * down / across)
    return replace(setup, sensor=sides, pitch=pitch, solved=width, sources={**setup.sources, "sensor": _SOLVER})


def _with_focal(setup: Setup) -> Setup:
    """Return the setup with what fx of a measured camera tells: the focal length from the pitch, or the reverse."""
    if not setup.measured or setup.camera is None:
        return setup
    fx, focus, sources = setup.camera.value("fx"), setup.focus or inf, dict(setup.sources)
    if setup.pitch is None and setup.focal is not None and setup.size is not None:
        pitch = optics.principal_distance(setup.focal, focus) / fx
        sources |= {"pitch": "focal length over fx", "sensor": "pixels times pitch"}
        return replace(setup, pitch=pitch, sensor=(setup.size[0] * pitch, setup.size[1] * pitch), sources=sources)
    if setup.pitch is None:
        return setup
    focal = optics.focal_length(fx * setup.pitch, focus)
    if setup.focal is None:
        return replace(setup, focal=focal, sources=sources | {"focal": "fx times pitch, and the focus"})
    if abs(focal / setup.focal - 1) <= _DISAGREE:
        return setup
    words = f"focal length {1e3 * focal:.2f} mm by fx and pitch, {1e3 * setup.focal:g} mm by --focal: check the pitch"
    values = {"focal_mm": 1e3 * focal, "given_mm": 1e3 * setup.focal}
    return replace(setup, warnings=(*setup.warnings, Message("focal_length_differs", words, values, "--focal")))


def _with_pinhole(setup: Setup) -> Setup:
    """Return the setup with a pinhole camera where none was read but lens, pixels and image size are known."""
    distance = setup.principal_distance
    if setup.camera is not None or setup.size is None or setup.pitch is None or distance is None:
        return setup
    model = model_named("pinhole")
    return replace(setup, camera=Camera(model, setup.size, model.start(setup.size, distance / setup.pitch)))


def _with_circle(setup: Setup) -> Setup:
    """Return the setup with the circle of confusion in metres: as given, or one pixel."""
    text = setup.options.circle
    if text is None:
        return replace(setup, circle=setup.pitch, sources={**setup.sources, "circle": "one pixel"})
    match = _CIRCLE.fullmatch(text.strip())
    if not match or not is_possible(float(match[1])):
        raise InvalidInput(f"--coc {text!r}: write a diameter with its unit, such as 5um, 0.03mm or 1.5px")
    if match[2] != "px":
        return replace(setup, circle=float(match[1]) * _METRES[match[2]])
    return replace(setup, circle=None if setup.pitch is None else float(match[1]) * setup.pitch)
