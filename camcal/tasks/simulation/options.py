"""The options of `camcal simulate`: images of a board, raw frames, rectified pairs."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import (
    BOARD,
    DEGREES,
    LENS,
    MILLIMETRES,
    NUMBER,
    PERCENT,
    RAW_FRAMES,
    SIZE,
    Argument,
    Option,
    OptionsRecord,
    ValueType,
    declared,
    separated,
)
from camcal.parsing import parse_number
from camcal.simulate.options import USUAL_SENSOR, Sensor
from camcal.tasks.options import (
    BOARD_OPTION,
    FOLDER,
    WHOLE,
    CameraName,
    ImagePart,
    Jobs,
    Overwrite,
    lens_model_names,
    lens_models,
    result_option,
)

if TYPE_CHECKING:
    from camcal.simulate.mosaics import RawCamera
    from camcal.simulate.render import Exposure, Shape

SCENE, IMAGE, PAIRS = "Scene", "Image", "Pairs"
MAX_LEVELS, MAX_DARKS = 200, 1000

_EVEN_LIGHT = (1.0, 1.0, 1.0)
_OF_PAIRS_TOO = {"stereo", "output", "size", "fov", "blur", "noise", "depth", "seed", "jobs", "overwrite"}
_OF_A_SENSOR = ("noise", "gamma", "depth")  # what it gives itself


def _read_coefficients(text: str) -> dict[str, float]:
    pairs = [part.split("=") for part in text.split(",") if part.strip()]
    return {name.strip(): parse_number(value) for name, value in pairs}


def _coefficients_text(values: Mapping[str, float]) -> str:
    return ",".join(f"{name}={NUMBER.write(value)}" for name, value in values.items())


COEFFICIENTS = ValueType(_read_coefficients, _coefficients_text, "coefficients, written as k1=-0.2,k2=0.05")
RANGE = separated("two numbers, written as 6:64", ":", 2)
LIGHT = separated("three numbers, written as .5,1,.6 (red, green, blue)", ",", 3)


@dataclass(frozen=True)
class BoardShape(OptionsRecord):
    """How the board differs from its drawing, in its unit (m, or squares when its size is unknown); see `Shape`.

    bow: along x and y. stretch: the ratio by which x is longer.
    """

    bow: Annotated[
        tuple[float, float],
        Option(
            "Bow of the board: height of the middle along x and y.",
            metavar="X Y",
            group=BOARD,
            names="--bow-mm",
            type=MILLIMETRES,
            values=2,
        ),
    ] = (0.0, 0.0)
    twist: Annotated[
        float,
        Option(
            "Twist of the board: height of its corners.",
            metavar="MM",
            group=BOARD,
            names="--twist-mm",
            type=MILLIMETRES,
        ),
    ] = 0.0
    cubic: Annotated[
        float,
        Option(
            "S-shaped bend along x: the factor of x³ - x.",
            metavar="MM",
            group=BOARD,
            names="--cubic-mm",
            type=MILLIMETRES,
        ),
    ] = 0.0
    stretch: Annotated[float, Option("Stretch of the print along x.", metavar="PERCENT", group=BOARD, type=PERCENT)] = (
        0.0
    )

    @property
    def formula(self) -> "Shape":
        """The shape that is simulated."""
        from camcal.simulate.render import Shape

        return Shape(*self.bow, self.twist, self.cubic, self.stretch)


AS_DRAWN = BoardShape()


@dataclass(frozen=True)
class RawOptions(OptionsRecord):
    """The raw camera, none without a pattern; levels of flat frames, two frames each, and the number of dark frames.

    light: on red, green and blue. aberration_px: lateral, at the corner of the image.
    """

    pattern: Annotated[
        str | None,
        Option(
            "Render 16-bit raw mosaics with this pattern: RGGB, GRBG, GBRG, BGGR, or MONO. The "
            "options --gain to --darks apply to them only.",
            metavar="PATTERN",
            group=RAW_FRAMES,
            names="--raw",
        ),
    ] = None
    sensor: Sensor = USUAL_SENSOR
    light: Annotated[
        tuple[float, float, float],
        Option(
            "Illumination of the colours R,G,B, such as .5,1,.6; by default 1,1,1.",
            metavar="R,G,B",
            group=RAW_FRAMES,
            type=LIGHT,
        ),
    ] = _EVEN_LIGHT
    aberration_px: Annotated[
        float,
        Option(
            "Lateral chromatic aberration: shift of red outwards and of blue inwards at the corner of the image.",
            metavar="PX",
            group=RAW_FRAMES,
            names="--aberration",
        ),
    ] = 0.0
    flats: Annotated[
        int, Option("Number of exposure levels of flat frames, two frames each.", metavar="N", group=RAW_FRAMES)
    ] = 0
    darks: Annotated[int, Option("Number of dark frames.", metavar="N", group=RAW_FRAMES)] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.flats <= MAX_LEVELS:
            raise InvalidInput(f"{self.flats} levels of flat frames: use 0 to {MAX_LEVELS}")
        if not 0 <= self.darks <= MAX_DARKS:
            raise InvalidInput(f"{self.darks} dark frames: use 0 to {MAX_DARKS}")
        if self.pattern is None and any(each.of(self) != each.default for each in declared(RawOptions)):
            raise InvalidInput("--gain, --light, --flats and the other options of a sensor need --raw PATTERN")

    @property
    def camera(self) -> "RawCamera | None":
        """The camera that makes the mosaics, None without a pattern."""
        from camcal.simulate.mosaics import RawCamera

        return None if self.pattern is None else RawCamera(self.pattern, self.sensor, self.light, self.aberration_px)


NOT_RAW = RawOptions()


@dataclass(frozen=True)
class PairsOptions(OptionsRecord):
    """How many rectified pairs, and what is known of their cameras and scenes; None is as in `PairOptions`.

    disparities: least and greatest, pixels; or distance: nearest and farthest, metres; without both 1 to 10 % of the
    width. right_gain, right_offset, right_gamma: of the right image. row_shift, row_tilt: how wrongly it lies.
    """

    count: Annotated[
        int, Option("Number of pairs, each of a different scene.", metavar="N", group=PAIRS, names="--pairs")
    ] = 1
    baseline: Annotated[
        float | None, Option("Baseline: distance of the two cameras; by default 0.1.", metavar="METRES", group=PAIRS)
    ] = None
    disparities: Annotated[
        tuple[float, float] | None,
        Option(
            "Disparities of the scene, pixels; by default 1 to 10 % of the width.",
            metavar="MIN:MAX",
            group=PAIRS,
            type=RANGE,
        ),
    ] = None
    distance: Annotated[
        tuple[float, float] | None,
        Option("Distances of the scene, metres, in place of disparities.", metavar="NEAR:FAR", group=PAIRS, type=RANGE),
    ] = None
    doffs: Annotated[
        float | None, Option("cx of the right camera minus cx of the left; by default 0.", metavar="PX", group=PAIRS)
    ] = None
    objects: Annotated[
        int | None,
        Option("Number of objects (boxes, balls, rods, …); by default 14.", metavar="N", group=PAIRS, least=0),
    ] = None
    gray: Annotated[bool, Option("Gray images; by default in colour.", group=PAIRS)] = False
    right_gain: Annotated[
        float | None, Option("Gain of the right image; by default 1.", metavar="FACTOR", group=PAIRS)
    ] = None
    right_offset: Annotated[
        float | None,
        Option("Offset added to the right image, 1/255 of full scale; by default 0.", metavar="DN", group=PAIRS),
    ] = None
    right_gamma: Annotated[
        float | None,
        Option("Gamma applied to the right image before the gain; by default 1.", metavar="POWER", group=PAIRS),
    ] = None
    row_shift: Annotated[
        float | None,
        Option("Vertical offset of the right image (positive: down); by default 0.", metavar="PX", group=PAIRS),
    ] = None
    row_tilt: Annotated[
        float | None,
        Option(
            "Difference of the vertical offset between right and left border; by default 0.", metavar="PX", group=PAIRS
        ),
    ] = None


ONE_PAIR = PairsOptions()


@dataclass(frozen=True)
class SimulateOptions(OptionsRecord):
    """What to photograph and how; see `camcal simulate --help`.

    camera: a camera file (FILE or FILE#NAME); name: which of its cameras. Without a file the lens is made of model,
    size (width, height), fov (rad) and distortion (coefficients by name, None for typical ones). partial: let boards be
    cut by the image. motion: of one board that moves. raw: make mosaics of a sensor, which then gives noise and depth.
    stereo: make `pairs`, without a board. What is None is as usual, and that differs between photographs and pairs.

    Raises InvalidInput for options that have no meaning with, or without, stereo.
    """

    output: Annotated[Path, result_option(FOLDER)]
    board: Annotated[str | None, Argument(BOARD_OPTION.help, metavar="BOARD")] = None
    camera: Annotated[
        str | None,
        Argument(
            "A camera file; all cameras of a rig, FILE#NAME for one of them; else --model and so on.", metavar="CAMERA"
        ),
    ] = None
    name: CameraName = None
    part: ImagePart = WHOLE
    model: Annotated[
        str | None,
        Option(
            lambda: f"Lens model: {lens_models()}; by default opencv5.",
            metavar="MODEL",
            group=LENS,
            suggested=lens_model_names,
        ),
    ] = None
    size: Annotated[
        tuple[int, int] | None,
        Option("Size of the images; by default 1280x960, of pairs 640x480.", metavar="WxH", group=LENS, type=SIZE),
    ] = None
    fov: Annotated[
        float | None,
        Option("Field of view across the width; by default 70, of pairs 60.", metavar="DEG", group=LENS, type=DEGREES),
    ] = None
    distortion: Annotated[
        Mapping[str, float] | None,
        Option(
            "Coefficients, such as k1=-0.2,k2=0.05; by default typical ones.",
            metavar="K1=…,…",
            group=LENS,
            type=COEFFICIENTS,
        ),
    ] = None
    shape: BoardShape = AS_DRAWN
    views: Annotated[int, Option("Number of images.", metavar="N", group=SCENE)] = 20
    partial: Annotated[bool, Option("Cut the board by the image border in every other view.", group=SCENE)] = False
    motion: Annotated[
        bool, Option("Images of one board that moves smoothly, as the frames of a video.", group=SCENE)
    ] = False
    gradient: Annotated[
        float,
        Option("Illumination gradient across the image.", metavar="PERCENT", group=SCENE, type=PERCENT),
    ] = 0.2
    vignetting: Annotated[
        float,
        Option("Vignetting: darkening of the image corners.", metavar="PERCENT", group=SCENE, type=PERCENT),
    ] = 0.1
    seed: Annotated[int, Option("Random seed of poses, scenes and noise.", metavar="N", group=SCENE, least=0)] = 0
    blur: Annotated[
        float | None,
        Option("Standard deviation of the lens blur; by default 0.7, of pairs 0.4.", metavar="PX", group=IMAGE),
    ] = None
    noise: Annotated[
        float | None,
        Option(
            "Standard deviation of the noise, in 1/255 of full scale; by default 2, of pairs 1.",
            metavar="DN",
            group=IMAGE,
        ),
    ] = None
    gamma: Annotated[
        float | None,
        Option("Encode images as brightness to the power 1/gamma; by default 1.", metavar="GAMMA", group=IMAGE),
    ] = None
    depth: Annotated[int | None, Option("Bits per pixel; by default 8.", metavar="8|16", group=IMAGE)] = None
    raw: RawOptions = NOT_RAW
    stereo: Annotated[
        bool,
        Option(
            "Render rectified stereo pairs of a generated scene instead of a board. Options: --pairs "
            "to --row-tilt, --size, --fov, --blur, --noise, --depth, --seed.",
            group=PAIRS,
        ),
    ] = False
    pairs: PairsOptions = ONE_PAIR
    jobs: Jobs = None
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for each in declared(SimulateOptions):
            of_pairs = each.path[0] == "pairs"
            if each.of(self) == each.default or (of_pairs and self.stereo) or each.path[0] in _OF_PAIRS_TOO:
                continue
            if self.stereo:
                raise InvalidInput(f"{each.name} cannot be used with --stereo")
            if of_pairs:
                raise InvalidInput(f"{each.name} needs --stereo")
        if self.motion and self.partial:
            raise InvalidInput("--motion excludes --partial")
        if self.raw.pattern is not None and any(getattr(self, name) is not None for name in _OF_A_SENSOR):
            raise InvalidInput("--raw excludes --noise, --gamma and --depth")

    @property
    def exposure(self) -> "Exposure":
        """Light and sensor of photographs."""
        from camcal.simulate.render import Exposure

        given: dict[str, Any] = {"blur_px": self.blur, "noise_dn": self.noise, "gamma": self.gamma, "depth": self.depth}
        known = {name: value for name, value in given.items() if value is not None}
        return Exposure(gradient=self.gradient, vignetting=self.vignetting, **known)
