"""The options of the commands of `camcal transform`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.files import STANDARD
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Without, Written
from camcal.tasks.options import Overwrite, output_option, result_option

if TYPE_CHECKING:
    from camcal.formats.pose_text import Form

LOOP_MM, LOOP_DEG = 1.0, 0.1
UNITS = ("m", "mm")
_TEXTS = (".txt", ".tum", ".kitti")
_CSV = ".csv"

Sources = Annotated[
    tuple[str, ...],
    Argument(
        "Quoted numbers, Rz(90deg), a file of numbers, FILE (all transforms of a frames, camera "
        "or pose file) or FILE#NAME; prefix numbers or a file with a name, such as "
        "base_T_cam=pose.txt.",
        metavar="POSE…",
        numbers=True,
    ),
]
FormName = Annotated[
    str | None,
    Option(
        "Representation of the numbers: matrix, quat:wxyz, quat:xyzw, rvec[:deg], euler:ZYX:deg "
        "(capitals intrinsic, xyz extrinsic), dual-quat, tum, kitti, colmap, ros; by default "
        "inferred from their count.",
        metavar="FORM",
        group=INPUT,
        names="--form",
    ),
]


def _transform_suffixes() -> tuple[str, ...]:
    from camcal.formats import frames

    return (*frames.SUFFIXES, *_TEXTS)


def _point_suffixes() -> tuple[str, ...]:
    from camcal.formats import pointclouds

    return (_CSV, *pointclouds.SUFFIXES)


@dataclass(frozen=True)
class Output(OptionsRecord):
    """Where transforms go, None for nowhere, and the form of their numbers in texts (None: matrix).

    trajectory: poses over time go there, under a suffix of theirs.
    """

    path: Annotated[
        Path | None,
        output_option(
            "Output file: .yaml or .json with covariances; or .txt.",
            Written(lambda: (*_transform_suffixes(), _CSV), stdout=True),
        ),
    ] = None
    form: Annotated[
        str | None,
        Option(
            "Print plain numbers in this representation, one of those of --form.",
            metavar="FORM",
            group=OUTPUT,
            names="--as",
        ),
    ] = None
    trajectory: Annotated[
        bool,
        Option(
            "POSE is a trajectory file, written to --output by its suffix or as tum, kitti, ros.",
            group=INPUT,
        ),
    ] = False
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        from camcal.formats.pose_text import form_of

        super().__post_init__()
        form_of(self.form)  # which refuses what is none
        if not self.trajectory and self.path is not None and self.path.suffix.lower() == _CSV:
            known = ", ".join(_transform_suffixes())
            raise InvalidInput(f"transforms are written as {known}", where=str(self.path))

    @property
    def numbers(self) -> "Form | None":
        """The form of numbers that was asked for."""
        from camcal.formats.pose_text import form_of

        return form_of(self.form)


PoseOutput = Annotated[Output, Without(("trajectory",))]


@dataclass(frozen=True)
class ChainOptions(OptionsRecord):
    """Arguments that stand for named transforms, and the frames to join: target_T_source.

    loop_mm, loop_deg: how far a loop of transforms without covariances may be from closing. form: of numbers.
    """

    sources: Sources
    target: Annotated[str, Option("Target frame: base of base_T_tag.", metavar="FRAME", group=INPUT, names="--to")]
    source: Annotated[str, Option("Source frame: tag of base_T_tag.", metavar="FRAME", group=INPUT, names="--from")]
    loop_mm: Annotated[
        float,
        Option(
            "Largest closure error (translation) of a loop of transforms without covariances.", metavar="MM", least=0
        ),
    ] = LOOP_MM
    loop_deg: Annotated[
        float, Option("Largest closure error (rotation) of such a loop.", metavar="DEGREES", least=0)
    ] = LOOP_DEG
    form: FormName = None
    output: PoseOutput = field(default_factory=Output)


@dataclass(frozen=True)
class ExpressionOptions(OptionsRecord):
    """A product such as 'a_T_b * inv(c_T_b)', and arguments that stand for its transforms."""

    expression: Annotated[
        str,
        Argument(
            "Expression such as 'a_T_b * inv(c_T_b)': names, *, inv() and parentheses.",
            metavar="EXPRESSION",
            numbers=True,
        ),
    ]
    sources: Annotated[
        tuple[str, ...],
        Option("File with transforms; repeatable.", metavar="POSE", group=INPUT, names="--frames -f"),
    ]
    form: FormName = None
    output: PoseOutput = field(default_factory=Output)


@dataclass(frozen=True)
class PosesOptions(OptionsRecord):
    """Arguments that stand for transforms, the form of numbers among them, and where the result goes."""

    sources: Sources
    form: FormName = None
    output: PoseOutput = field(default_factory=Output)


@dataclass(frozen=True)
class ConvertOptions(OptionsRecord):
    """Arguments that stand for poses and the form of numbers among them; inverse: of each pose, before all else.

    axes: changes such as camera=opencv:opengl, where frames of poses without names are a and b.
    """

    sources: Sources
    axes: Annotated[
        tuple[str, ...],
        Option(
            "Change the axis convention of a frame, such as camera=opencv:opengl (unnamed frames are "
            "a and b); repeatable. Conventions: opencv, colmap, ros_optical, opengl, blender, nerf, "
            "unity, ros, enu, ned.",
            metavar="FRAME=FROM:TO",
        ),
    ] = ()
    inverse: Annotated[bool, Option("Invert the poses first: b_T_a for a_T_b.")] = False
    form: FormName = None
    output: Output = field(default_factory=Output)


@dataclass(frozen=True)
class AverageOptions(OptionsRecord):
    """Arguments that stand for estimates of one transform, the form of numbers among them.

    robust: estimates far from the others count little. equal: all count alike, whatever their covariances.
    trajectory: the arguments are trajectory files, all poses of which are estimates.
    """

    sources: Sources
    robust: Annotated[bool, Option("Robust mean: reduce the weight of outliers.")] = False
    equal: Annotated[bool, Option("Weight all poses equally, ignoring their covariances.")] = False
    trajectory: Annotated[
        bool, Option("The arguments are trajectory files of a static object: average all their poses.", group=INPUT)
    ] = False
    form: FormName = None
    output: PoseOutput = field(default_factory=Output)


@dataclass(frozen=True)
class CheckOptions(OptionsRecord):
    """Arguments that stand for poses, the form of numbers among them; fix: give the nearest poses, to `output` too."""

    sources: Sources
    fix: Annotated[
        bool, Option("Replace invalid poses by the nearest valid ones, also in --output; reflections have none.")
    ] = False
    form: FormName = None
    output: PoseOutput = field(default_factory=Output)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.output.path is not None and not self.fix:
            raise InvalidInput("--output is for the poses that --fix makes")


@dataclass(frozen=True)
class PointsOptions(OptionsRecord):
    """A file of points, an argument that stands for a transform a_T_b, and where points in a are written.

    inverse: points are in a and go to b. form: of the transform's numbers. unit: of a CSV's points, m or mm.
    """

    points: Annotated[
        Path,
        Argument(
            "A CSV with columns x,y,z, also nx,ny,nz and sxx,sxy,sxz,syy,syz,szz; or a cloud: PLY, PCD, XYZ, "
            "NPZ, GLB, LAS, LAZ.",
            metavar="FILE",
            numbers=True,
        ),
    ]
    transform: Annotated[
        str,
        Option(
            "a_T_b, where the points are in b: numbers, a file or FILE#NAME.",
            metavar="POSE",
            group=INPUT,
            names="--with",
        ),
    ]
    output: Annotated[Path, result_option(Written(_point_suffixes, stdout=True))]
    inverse: Annotated[bool, Option("Apply the inverse: from a to b.")] = False
    form: FormName = None
    unit: Annotated[
        str, Option("Unit of the points of a CSV; clouds state theirs.", metavar="m|mm", group=INPUT, choices=UNITS)
    ] = "m"
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.is_table != _is_table(self.output):
            raise InvalidInput("a CSV is written as a CSV and a cloud as a cloud", where=str(self.output))

    @property
    def is_table(self) -> bool:
        """Whether the points are a CSV, not a cloud."""
        return _is_table(self.points)


def _is_table(path: Path) -> bool:
    return str(path) == STANDARD or path.suffix.lower() == _CSV
