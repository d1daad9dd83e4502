"""The options of `camcal optics`: a lens, its sensor, its use, and a board before it."""

from math import inf
from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import (
    BOARD,
    DEGREES,
    LENS,
    METHOD,
    MICROMETRES,
    MILLIMETRES,
    MILLISECONDS,
    NUMBERS,
    OUTPUT,
    SIZE,
    Argument,
    Option,
    OptionsRecord,
    declared,
    scaled,
)
from camcal.tasks.options import FIGURES, WHOLE, BoardText, CameraName, ImagePart, Overwrite

SENSOR, SCENE = "Sensor", "Scene"
SOLVABLE = ("f", "wd", "sensor")

_LEAST, _MOST = 1e-12, 1e12  # in SI units and pixels: beyond, products of lengths overflow, and nothing is real
_MOST_PIXELS = 1_000_000  # of an image's side
_MOST_PX = 1e6  # of a length on the board
_STEEPEST = DEGREES.read("80")


@dataclass(frozen=True)
class BoardOptions(OptionsRecord):
    """A board (file or short form, None for none), its tilt (rad) about the vertical, and what is asked of it.

    noise_px: of a corner of a sharp board at rest. share: of the image's width or height that the board is to take.
    least_px: the smallest square that is still detected, None for what the kind of board needs. views: of a
    calibration.
    """

    board: BoardText = None
    tilt: Annotated[
        float,
        Option(
            "Tilt of the board about the vertical axis.",
            metavar="DEG",
            group=BOARD,
            type=DEGREES,
            least=-_STEEPEST,
            most=_STEEPEST,
        ),
    ] = 0.0
    noise_px: Annotated[
        float,
        Option(
            "Standard deviation of a corner of a sharp board at rest.", metavar="PIXELS", group=BOARD, names="--noise"
        ),
    ] = 0.1
    share: Annotated[
        float,
        Option("Share of the image width or height covered by the board.", metavar="SHARE", group=BOARD),
    ] = 0.6
    least_px: Annotated[
        float | None,
        Option(
            "Smallest detectable square; by default 8, or 2 for a marker's cell.",
            metavar="PIXELS",
            group=BOARD,
            names="--least-square",
        ),
    ] = None
    views: Annotated[
        int,
        Option("Number of views of the board, for the forecast of a calibration.", metavar="N", group=BOARD, least=1),
    ] = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.share <= 1:
            raise InvalidInput(f"--share must be more than 0 and at most 1, found {self.share:g}")
        if not all(0 < pixels <= _MOST_PX for pixels in (self.noise_px, self.least_px) if pixels is not None):
            raise InvalidInput(f"--noise and --least-square must be more than 0 and at most {_MOST_PX:g} px")


NO_BOARD = BoardOptions()


@dataclass(frozen=True)
class OpticsOptions(OptionsRecord):
    """What is given of a lens; None is unknown. Lengths in metres, times in seconds.

    camera: a camera file (FILE or FILE#NAME), name: of the camera in it. sensor: a format's name, or WxH in mm.
    pitch: of the pixels. size: of the image, pixels. focus: distance in focus. circle: of confusion, such as 5um or
    1px, None for one pixel. image_circle: diameter that the lens lights. speed: across the line of sight, m/s.
    distances: to say figures for. solve: f, wd or sensor, so that `width` fills the image. plan: a board to forecast.
    plot: a file for the blur over distance. formats: list the sensor formats in place of all this.
    """

    camera: Annotated[
        str | None,
        Argument("Camera file, or FILE#NAME, for field of view and resolution.", metavar="CAMERA"),
    ] = None
    name: CameraName = None
    part: ImagePart = WHOLE
    focal: Annotated[
        float | None, Option("Focal length.", metavar="MM", group=LENS, names="--focal --f", type=MILLIMETRES)
    ] = None
    f_number: Annotated[
        float | None, Option("F-number of the lens.", metavar="N", group=LENS, names="--f-number --N")
    ] = None
    focus: Annotated[
        float | None,
        Option("Distance in focus, from the front principal plane; inf for infinity.", metavar="METRES", group=LENS),
    ] = None
    circle: Annotated[
        str | None,
        Option(
            "Circle of confusion: 5um, 0.03mm or 1.5px; by default 1px.", metavar="LENGTH", group=LENS, names="--coc"
        ),
    ] = None
    wavelength: Annotated[
        float, Option("Wavelength, for diffraction.", metavar="NM", group=LENS, type=scaled(1e-9))
    ] = 550e-9
    image_circle: Annotated[
        float | None,
        Option(
            "Image circle diameter of the lens; checked against the sensor.", metavar="MM", group=LENS, type=MILLIMETRES
        ),
    ] = None
    sensor: Annotated[
        str | None,
        Option("Sensor format such as 1/1.8, or its sides in mm: 7.2x5.4.", metavar="NAME|WxH", group=SENSOR),
    ] = None
    pitch: Annotated[
        float | None,
        Option(
            "Pixel pitch, micrometres.",
            metavar="UM",
            group=SENSOR,
            names="--pitch-um --pitch",
            type=MICROMETRES,
        ),
    ] = None
    size: Annotated[
        tuple[int, int] | None, Option("Size of the image in pixels.", metavar="WxH", group=SENSOR, type=SIZE)
    ] = None
    distances: Annotated[
        tuple[float, ...],
        Option(
            "Distances to evaluate; by default the focus distance.",
            metavar="M,…",
            group=SCENE,
            names="--distance",
            type=NUMBERS,
        ),
    ] = ()
    speed: Annotated[float | None, Option("Speed of the object across the view.", metavar="M/S", group=SCENE)] = None
    exposure: Annotated[float | None, Option("Exposure time.", metavar="MS", group=SCENE, type=MILLISECONDS)] = None
    baseline: Annotated[float | None, Option("Baseline: distance of the cameras.", metavar="METRES", group=SCENE)] = (
        None
    )
    disparity_noise: Annotated[
        float, Option("Standard deviation of a stereo disparity.", metavar="PIXELS", group=SCENE)
    ] = 0.25
    plan: BoardOptions = NO_BOARD
    solve: Annotated[
        str | None,
        Option(
            "Find the lens, the working distance or the sensor.",
            metavar="f|wd|sensor",
            group=METHOD,
            choices=SOLVABLE,
        ),
    ] = None
    width: Annotated[
        float | None,
        Option("Width of the object that fills the image, for --solve.", metavar="METRES", group=METHOD),
    ] = None
    formats: Annotated[bool, Option("Only list the sensor formats.", group=OUTPUT)] = False
    plot: Annotated[
        Path | None,
        Option(
            "Plot the blur over distance (.png, .svg, .pdf).",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=FIGURES,
        ),
    ] = None
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for each in declared(OpticsOptions):
            value = each.of(self) if each.path in _POSITIVE else None
            if value is not None and not (is_possible(value) or (each.path == ("focus",) and value == inf)):
                reason = "is implausible" if 0 < value < inf else "must be more than 0 and finite"
                raise InvalidInput(f"{each.name} {reason}, found {each.written(value)}")
        if not all(map(is_possible, self.distances)):
            raise InvalidInput(f"--distance must be more than 0 m and at most {_MOST:g} m")
        if self.size is not None and max(self.size) > _MOST_PIXELS:
            raise InvalidInput(f"--size: an image side of {max(self.size):g} pixels is implausible")
        if (self.solve is None) != (self.width is None):
            raise InvalidInput("--solve f, wd or sensor and --width METRES, what is to fill the image, go together")


_POSITIVE = {
    (name,)
    for name in (
        "focal", "pitch", "f_number", "focus", "wavelength", "image_circle", "speed", "exposure", "baseline",
        "disparity_noise", "width",
    )
}  # fmt: skip


def is_possible(value: float) -> bool:
    """Return whether a length, a time or a speed is one that can be computed with."""
    return _LEAST <= value <= _MOST
