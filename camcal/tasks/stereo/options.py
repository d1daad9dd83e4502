"""The options of the commands about rectified pairs and point clouds."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.options import CHECKS, INPUT, OUTPUT, SIZE, Argument, Option, OptionsRecord, ValueType, Without, Written
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.stereo.options import MatchOptions
from camcal.tasks.options import (
    NO_FIGURES,
    PICTURES,
    WHOLE,
    CameraName,
    FigureOptions,
    GivenCamera,
    ImagePart,
    Jobs,
    Overwrite,
    Recursive,
    output_option,
    result_option,
)

CAMERA = "Camera of the pair"
MAP_TYPES = ("pfm", "tiff", "tif", "png", "npy", "npz", "exr")
OWN, ONNX = "own", "onnx"
ENGINES = (OWN, ONNX)
INTRINSICS = ("fx", "fy", "cx", "cy")
PAGE, PICTURE, VIDEO, RECORDING, WINDOW = "page", "picture", "video", "recording", "window"
KINDS: Mapping[str, str] = MappingProxyType(  # of what shows a cloud, by suffix
    {".html": PAGE, ".png": PICTURE, ".gif": VIDEO, ".mp4": VIDEO, ".rrd": RECORDING}
)


def _two_names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if len(names) != 2 or len(set(names)) != 2 or not all(names):
        raise ValueError(text)
    return names


ONE_SIDE = ValueType(lambda text: (text,), lambda paths: " ".join(map(str, paths)), "a path")

PairNames = Annotated[
    tuple[str, ...] | None,
    Option(
        "Names of the cameras of LEFT and RIGHT, where the file has more than two or another order; the same as "
        "RIG#LEFT,RIGHT.",
        metavar="LEFT,RIGHT",
        group=INPUT,
        names="--cameras",
        type=ValueType(_two_names, ",".join, "two names, such as left,right"),
    ),
]
Force = Annotated[
    bool, Option("Exit with 0 even if a pair is swapped, not rectified, or hardly matched.", group=CHECKS)
]
PairCamera = Annotated[
    str | None,
    Argument(
        "Camera file of the rectified pair, or FILE#NAME; or a calib.txt. Or a rig file: the pair is rectified first.",
        metavar="CAMERA",
    ),
]


@dataclass(frozen=True)
class GeometryOptions(OptionsRecord):
    """What the command line says of a pair. camera: name of the left one in the file. fx … doffs: pixels and metres.

    given: the left camera at once, in place of fx … cy; rectified, so that its distortion can only be zero.
    """

    camera: CameraName = None
    given: Annotated[GivenCamera, Without(("model",))] = field(default_factory=GivenCamera)
    fx: Annotated[float | None, Option("Focal length.", metavar="PIXELS", group=CAMERA)] = None
    fy: Annotated[float | None, Option("Focal length along y; by default fx.", metavar="PIXELS", group=CAMERA)] = None
    cx: Annotated[float | None, Option("Principal point of the left image, x.", metavar="PIXELS", group=CAMERA)] = None
    cy: Annotated[float | None, Option("Principal point, y.", metavar="PIXELS", group=CAMERA)] = None
    baseline: Annotated[float | None, Option("Baseline: distance of the cameras.", metavar="METRES", group=CAMERA)] = (
        None
    )
    doffs: Annotated[
        float | None,
        Option("cx of the right image minus cx of the left; by default 0.", metavar="PIXELS", group=CAMERA),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(self.given.distortion or ()):
            raise InvalidInput(
                "--distortion: rectified images have none; give the camera matrix of the rectified camera"
            )
        twice = [f"--{name}" for name in INTRINSICS if self.given.camera_matrix and getattr(self, name) is not None]
        if twice:
            raise InvalidInput(f"--camera-matrix and {', '.join(twice)} are redundant; leave one out")

    def numbers(self) -> dict[str, float]:
        """Return the numbers that are given, by name."""
        known = dict(zip(INTRINSICS, self.given.camera_matrix or (), strict=False))
        single = {name: getattr(self, name) for name in (*INTRINSICS, "baseline", "doffs")}
        return known | {name: value for name, value in single.items() if value is not None}


def _map_suffixes() -> tuple[str, ...]:
    from camcal.formats import disparity

    return disparity.SUFFIXES


@dataclass(frozen=True)
class StereoCheckOptions(OptionsRecord):
    """Pairs (files, folders, patterns of either side), where their pictures go, and what they must hold.

    camera_file: as of DisparityOptions; of cameras above each other columns are checked. camera: the left one in it, or
    both as LEFT,RIGHT. output: a file for a single pair, otherwise a folder. max_rms: the largest root mean square that
    rows may be off, pixels; with it, pairs that are swapped or one image twice fail too.
    """

    left: Annotated[
        tuple[str, ...],
        Argument("The left image, or a folder or quoted pattern of several.", metavar="LEFT", type=ONE_SIDE),
    ]
    right: Annotated[
        tuple[str, ...],
        Argument("The right image, or as many as there are left ones.", metavar="RIGHT", type=ONE_SIDE),
    ]
    camera_file: PairCamera = None
    camera: CameraName = None
    part: ImagePart = WHOLE
    output: Annotated[
        Path | None,
        output_option("A picture of the check (.png); a folder for several pairs.", Written((".png",), folder=True)),
    ] = None
    max_rms: Annotated[
        float | None,
        Option(
            "Exit with 7 if the row offsets (RMS) are larger, or if the images are swapped or identical; try 0.5.",
            metavar="PIXELS",
            group=CHECKS,
        ),
    ] = None
    recursive: Recursive = False
    jobs: Jobs = None
    batch: Annotated[BatchOptions, Without(("resume",))] = DEFAULT_BATCH
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_rms is not None and not self.max_rms > 0:
            raise InvalidInput(f"--max-rms must be more than 0 px, found {self.max_rms:g}")


@dataclass(frozen=True)
class DisparityOptions(OptionsRecord):
    """Pairs (files, folders, patterns of either side), where their maps go, and how they are matched.

    output: a file for a single pair, otherwise a folder. camera_file: of the rectified pair, FILE or FILE#NAME; or of
    two cameras that are not rectified, by which the images are rectified first (FILE#LEFT,RIGHT of more cameras).
    type: of the files in a folder. model: the network of the engine onnx. picture: draw each map. map_only: write no
    uncertainty and no classes beside it. force: a pair that is none, or a map that is worth nothing, is no failure.
    """

    left: Annotated[
        tuple[str, ...],
        Argument(
            "Left image, rectified or of a rig file; or a folder, or a quoted glob.", metavar="LEFT", type=ONE_SIDE
        ),
    ]
    right: Annotated[tuple[str, ...], Argument("Right image, folder or glob.", metavar="RIGHT", type=ONE_SIDE)]
    output: Annotated[Path, result_option(Written(_map_suffixes, folder=True))]
    camera_file: PairCamera = None
    geometry: GeometryOptions = field(default_factory=GeometryOptions)
    matching: MatchOptions = field(default_factory=MatchOptions)
    engine: Annotated[
        str, Option("Matcher: own, or onnx with the network given by --model.", metavar="own|onnx", choices=ENGINES)
    ] = OWN
    model: Annotated[Path | None, Option("Stereo network of your own, ONNX.", metavar="FILE")] = None
    type: Annotated[
        str,
        Option(
            "Type of the maps in a folder: tiff, pfm, png, npy, npz, exr.",
            metavar="TYPE",
            group=OUTPUT,
            choices=MAP_TYPES,
        ),
    ] = "tiff"
    picture: Annotated[
        bool, Option("Write a colour picture of each map with a legend, MAP.vis.png.", group=OUTPUT, names="--vis")
    ] = False
    map_only: Annotated[bool, Option("Do not write .sigma.tiff and .confidence.png beside the map.", group=OUTPUT)] = (
        False
    )
    force: Force = False
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.engine == ONNX) != (self.model is not None):
            raise InvalidInput("--engine onnx and --model FILE go together")
        if self.model is not None and self.matching != MatchOptions():
            raise InvalidInput(
                "a network takes no --quality, --range, --fill, --align-rows, --exposure; leave them out"
            )


@dataclass(frozen=True)
class TruthPair(OptionsRecord):
    """The files that belong to one disparity map; as options, folders of them.

    truth: of the left image. mask: what both cameras see. right_truth: of the right image, which tells that as well.
    sigma, confidence: the uncertainty and the class of every pixel.
    """

    disparity: Annotated[Path, Argument("Disparity map of the left image, or a folder of maps.", metavar="DISPARITY")]
    truth: Annotated[Path, Argument("Ground-truth disparity, or a folder in the same natural order.", metavar="TRUTH")]
    mask: Annotated[
        Path | None,
        Option("Mask of non-occluded pixels: 8 bits of 255, or 16 bits not 0.", metavar="FILE", group=INPUT),
    ] = None
    right_truth: Annotated[
        Path | None,
        Option("Ground-truth disparity of the right image, to determine occlusions.", metavar="FILE", group=INPUT),
    ] = None
    sigma: Annotated[
        Path | None,
        Option("Standard deviation of every pixel; by default from the sidecar.", metavar="FILE", group=INPUT),
    ] = None
    confidence: Annotated[
        Path | None,
        Option("Confidence class of every pixel; by default from the sidecar.", metavar="FILE", group=INPUT),
    ] = None

    @property
    def files(self) -> Mapping[str, Path]:
        """What there is, by name."""
        found = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: path for name, path in found.items() if path is not None}


_MATRIX = ("given.camera_matrix", "given.distortion", "given.size")


@dataclass(frozen=True)
class EvalOptions(OptionsRecord):
    """Disparity maps and truths, how to read them, and what is asked of them.

    files: one file of each kind, or folders. scale, truth_scale: counts per pixel of disparity, None by the sidecar or
    the type of file. camera_file: FILE or FILE#NAME of the rectified pair. geometry: comes before that, and both before
    the sidecars. output: an error picture, or a folder of them. gates: such as "bad2=2.5" or
    "bad2:all=5": the worst that will do.
    """

    files: TruthPair
    camera_file: Annotated[
        str | None,
        Argument(
            "Camera file of the rectified pair or FILE#NAME; or Middlebury's or KITTI's calib.txt. For depth.",
            metavar="CAMERA",
        ),
    ] = None
    output: Annotated[
        Path | None,
        output_option("Error picture; for folders a folder.", PICTURES),
    ] = None
    scale: Annotated[
        float | None,
        Option(
            "Counts of the map per pixel; by default from its sidecar, or 256 for 16-bit (signed: 16), else 1.",
            metavar="COUNTS",
            group=INPUT,
        ),
    ] = None
    truth_scale: Annotated[
        float | None,
        Option("Counts of the ground truth per pixel, such as 4 for Middlebury 2003.", metavar="COUNTS", group=INPUT),
    ] = None
    geometry: Annotated[GeometryOptions, Without(("fy", "cx", "cy", *_MATRIX))] = field(default_factory=GeometryOptions)
    gates: Annotated[
        tuple[str, ...],
        Option(
            "Fail (exit 7) if a figure is worse: bad2=2.5, bad2:all=5. Repeatable.",
            metavar="FIGURE=LIMIT",
            group=CHECKS,
            names="--gate",
        ),
    ] = ()
    jobs: Jobs = None
    batch: Annotated[BatchOptions, Without(("resume",))] = DEFAULT_BATCH
    figures: FigureOptions = NO_FIGURES
    overwrite: Overwrite = False


@dataclass(frozen=True)
class ViewOptions(OptionsRecord):
    """A point cloud or a disparity map, and how it is shown.

    image: the left image of a disparity map. output: its suffix says what is made; None for the window of the Rerun
    viewer. frame: where the axes of a cloud point, by name or in words; None for what its file says. colour: one of
    `colour_scale.COLOURS`, None for the image's where there is one, else depth. view: see `cloud_views.view_of`;
    montage: four views in its place. size: (width, height) of a picture or video. max_points: None for as many as suit
    what is made. turn: degrees of a video, None for once round, or to and fro before what a camera saw.
    """

    source: Annotated[
        Path,
        Argument(
            "Point cloud (PLY, PCD, XYZ, NPZ, GLB, LAS, LAZ), or disparity map with its sidecar.",
            metavar="CLOUD|DISPARITY",
        ),
    ]
    image: Annotated[
        Path | None,
        Argument("Left image for the colours of a map; by default from the sidecar.", metavar="IMAGE"),
    ] = None
    output: Annotated[
        Path | None,
        output_option(
            "A page (.html), a picture (.png), a video (.gif, .mp4) or a recording for Rerun (.rrd).",
            Written(tuple(KINDS)),
        ),
    ] = None
    frame: Annotated[
        str | None,
        Option(
            "Axis convention of a cloud: optical, camera, ros, opengl, enu, or such as 'x forward, y "
            "left, z up'; by default from its file.",
            metavar="NAME|WORDS",
            group=INPUT,
        ),
    ] = None
    colour: Annotated[
        str | None,
        Option("Colour by image, depth, sigma or gray; by default image, or depth if there is none.", metavar="NAME"),
    ] = None
    view: Annotated[
        str,
        Option(
            "Viewpoint: camera, front, top, side, or AZ,EL[,DIST] (degrees to the right and up, distance).",
            metavar="VIEW",
        ),
    ] = "camera"
    montage: Annotated[bool, Option("Four views in one picture.")] = False
    size: Annotated[
        tuple[int, int] | None,
        Option("Pixels of a picture or video; by default 1280 or 640 wide, as high as fits.", metavar="WxH", type=SIZE),
    ] = None
    point_size: Annotated[float, Option("Size of the points; 1 fills the gaps of surfaces.", metavar="FACTOR")] = 1.0
    max_points: Annotated[
        int | None,
        Option(
            "Maximum number of points shown; by default 400000 in a page, 1000000 in a video, else 4000000.",
            metavar="N",
            least=1,
        ),
    ] = None
    turn: Annotated[
        float | None,
        Option(
            "Camera orbit of a video: 360 for a full turn, less for a swing; by default 50 for a "
            "cloud seen from one camera, else 360.",
            metavar="DEGREES",
        ),
    ] = None
    frames: Annotated[int, Option("Number of frames of a video, 20 per second.", metavar="N", least=2)] = 60
    rerun: Annotated[
        bool,
        Option("Open the Rerun viewer, or with -o write for it; needs camcal[view].", group=OUTPUT),
    ] = False
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.1 <= self.point_size <= 10:
            raise InvalidInput(f"points are 0.1 to 10 times as large as usual, not {self.point_size:g}")
        if self.turn is not None and not 0 < self.turn <= 360:
            raise InvalidInput(f"a turn is more than 0 and at most 360 degrees, not {self.turn:g}")
        if self.montage and self.view != ViewOptions.view:
            raise InvalidInput("--montage has views of its own; leave --view out")
