"""The options of `camcal rig` and `camcal stereo calibrate`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.options import (
    BOARD,
    INPUT,
    LENS,
    METHOD,
    MILLISECONDS,
    Argument,
    Option,
    OptionsRecord,
    ValueType,
    Without,
)
from camcal.raw.options import AS_IMAGES, ImageReadOptions
from camcal.tasks.calibration.options import CalibrationOptions
from camcal.tasks.options import BOARD_OPTION, CAMERA_FILE, board_text, lens_model_names, lens_models, result_option

if TYPE_CHECKING:
    from camcal.targets.board import Board


def named_board(text: str) -> tuple[str, str]:
    """Return the name that a text gives a board, empty without one, and the text that means the board."""
    name, mark, rest = text.partition("=")
    return (name, rest) if mark and not {"/", ":"} & set(name) and not Path(text).exists() else ("", text)


def named_board_text(text: str) -> str:
    """Return the text that means a board, or one with a name; raises InvalidInput for a short form that is wrong."""
    board_text(named_board(text)[1])
    return text


AUTO, NAME, INDEX, TIME = "auto", "name", "index", "time"
MATCHES = (AUTO, NAME, INDEX, TIME)
JOINT, FIXED, PRIOR = "joint", "fixed", "prior"


@dataclass(frozen=True)
class RigSettings(CalibrationOptions):
    """How the cameras of a rig are calibrated; see `camcal rig --help`.

    board: None where a detections file names it, else a tuple of boards, with names where there are several. joined:
    groups of their names; none: all are. relations, distances: what is known of them. match: how images of one capture
    are found. tolerance: s, None for half of the shortest interval. models: a lens model, or NAME=MODEL for single
    cameras; none for those that predict views best. guess: camera files, or NAME=FILE for single cameras. lenses: joint
    estimates them with the rig, starting at a guess if there is one; fixed and prior need one.
    """

    output: Annotated[Path | None, result_option(CAMERA_FILE)] = None
    board: Annotated[
        "Board | str | tuple[Board | str, ...] | None",
        replace(
            BOARD_OPTION,
            help=f"{BOARD_OPTION.help} NAME=BOARD for each of several boards, repeated.",
            metavar="BOARD|NAME=BOARD",
            type=ValueType(named_board_text, str, "a board"),
            several=True,
        ),
    ] = None
    joined: Annotated[
        tuple[str, ...],
        Option(
            "Boards that are joined rigidly, such as a,b (repeated), or none; by default all of several boards. Where "
            "they stand on each other is estimated.",
            metavar="NAME,NAME…",
            group=BOARD,
        ),
    ] = ()
    relations: Annotated[
        Path | None,
        Option(
            "Known relations of joined boards: a file with transforms such as a_T_b with their covariance or std, as "
            "an earlier 'camcal rig' writes it.",
            metavar="FILE",
            group=BOARD,
            names="--board-poses",
        ),
    ] = None
    distances: Annotated[
        tuple[str, ...],
        Option(
            "Measured distance of two points with its standard deviation, such as 0:53=0.25m±0.1mm, or "
            "a.0:b.12=1.503m±2mm of points of several boards; repeated. Distances set the scale: the size of a square "
            "is then known to 1 % only.",
            metavar="POINT:POINT=LENGTH±STD",
            group=BOARD,
            names="--distance",
        ),
    ] = ()
    match: Annotated[
        str,
        Option(
            "What images of one capture have in common: their name without the part that names the camera, their "
            "index, or their time. By default the name, for videos the time, else the index if the counts agree.",
            metavar="|".join(MATCHES),
            group=INPUT,
            choices=MATCHES,
        ),
    ] = AUTO
    tolerance: Annotated[
        float | None,
        Option(
            "Largest time difference within a capture; by default half of the shortest frame interval.",
            metavar="MS",
            group=INPUT,
            names="--time-tolerance",
            type=MILLISECONDS,
            least=0,
        ),
    ] = None
    models: Annotated[
        tuple[str, ...],
        Option(
            lambda: (
                f"Lens model of all cameras, or NAME=MODEL for one, repeated: {lens_models()}. Default: chosen for "
                "all cameras of a kind by how well it predicts views."
            ),
            metavar="MODEL|NAME=MODEL",
            group=LENS,
            names="--model",
            suggested=lens_model_names,
        ),
    ] = ()
    lenses: Annotated[
        str,
        Option(
            "Lenses are estimated jointly with the rig (joint), held at the guess (fixed), or start at it with its "
            "covariance as prior (prior), which needs a calibration from other images.",
            metavar="joint|fixed|prior",
            group=LENS,
            choices=(JOINT, FIXED, PRIOR),
        ),
    ] = JOINT
    guess: Annotated[
        tuple[str, ...],
        Option(
            "Camera file with the lenses of all cameras by their names, or NAME=FILE for one, repeated.",
            metavar="FILE|NAME=FILE",
            group=LENS,
        ),
    ] = ()
    reading: Annotated[ImageReadOptions, Without(("colours",))] = field(default=AS_IMAGES, kw_only=True)
    motion: Annotated[
        bool | None,
        Option(
            "Estimate how far the board moved between the exposures of a capture; by default where the residuals call "
            "for it.",
            group=METHOD,
        ),
    ] = None
    time_offset: Annotated[
        bool,
        Option(
            "Estimate the time offset and the clock rate of every camera against the first from the motion of the "
            "board: images need times; all frames of videos are used.",
            group=METHOD,
        ),
    ] = False

    def __post_init__(self) -> None:
        if self.board is not None and not isinstance(self.board, tuple):
            object.__setattr__(self, "board", (self.board,))
        super().__post_init__()
        if self.lenses != JOINT and not self.guess:
            raise InvalidInput(f"--lenses {self.lenses} needs the lenses: give --guess FILE, or --guess NAME=FILE")
        if self.timed and self.match not in (AUTO, TIME):
            raise InvalidInput(f"--time-offset and --rolling-shutter match by time, not by {self.match}")
        if self.tolerance is not None and self.match in (NAME, INDEX):
            raise InvalidInput(f"--time-tolerance goes with --match {TIME}, not with --match {self.match}")

    @property
    def timed(self) -> bool:
        """Whether images have times of their own, and are no captures yet."""
        return self.time_offset or self.rolling_shutter


DEFAULTS = RigSettings()


@dataclass(frozen=True)
class RigTaskOptions(OptionsRecord):
    """The inputs of every camera (NAME=PATH, or PATH named by its folder or pattern), and how they are calibrated."""

    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "NAME=PATH for each camera, such as left=photos/left right=photos/right: images, a folder, a quoted glob, "
            "a video or a detections file. Or one folder or detections file with the images of all cameras.",
            metavar="NAME=PATH…",
            required=True,
        ),
    ] = ()
    settings: RigSettings = DEFAULTS


@dataclass(frozen=True)
class StereoCalibrateOptions(OptionsRecord):
    """The inputs of the left and the right camera, and how they are calibrated; right: None where left has both."""

    left: Annotated[
        str,
        Argument(
            "Images of the left camera: a folder, a quoted glob, a video or a detections file; or a folder with those "
            "of both.",
            metavar="LEFT",
            required=True,
        ),
    ] = ""
    right: Annotated[str | None, Argument("Images of the right camera.", metavar="RIGHT")] = None
    settings: RigSettings = DEFAULTS
