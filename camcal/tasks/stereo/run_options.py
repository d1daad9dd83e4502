"""The options of rectification, of point clouds and of `camcal stereo run`, which has them all."""

from dataclasses import fields
from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.images.options import JPEG_QUALITY
from camcal.options import INPUT, NUMBERS, OUTPUT, PERCENT, Argument, Option, OptionsRecord, Without, Written
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.stereo.options import MatchOptions, RectifiedViewOptions
from camcal.tasks.options import (
    CAMERA_SUFFIXES,
    FOLDER,
    WHOLE,
    GivenCamera,
    ImagePart,
    Jobs,
    JpegQuality,
    Overwrite,
    PictureFormat,
    Recursive,
    output_option,
    result_option,
)
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.stereo.options import ONE_SIDE, Force, GeometryOptions, PairCamera, PairNames


@dataclass(frozen=True)
class RectifyOptions(OptionsRecord):
    """A rig, pairs of its images (files, folders, patterns, videos of either side), and how they are rectified.

    rig: a camera file with a transform between two cameras, or FILE#LEFT,RIGHT. cameras: their names, in the order of
    the images. second: the other file of a rig that is written as two. maps, opencv, ros: write maps.npz, opencv.yml
    with R1 R2 P1 P2 Q, and a folder ros with camera_info. format: None keeps the type of the source.
    """

    rig: Annotated[
        str,
        Argument("Camera file with two cameras and their transform, of camcal, OpenCV, ROS or Kalibr.", metavar="RIG"),
    ]
    output: Annotated[Path, output_option("Output folder.", FOLDER, required=True)]
    left: Annotated[
        tuple[str, ...],
        Argument("Image or video of the first camera, folder or quoted glob.", metavar="LEFT", type=ONE_SIDE),
    ] = ()
    right: Annotated[tuple[str, ...], Argument("The same of the second camera.", metavar="RIGHT", type=ONE_SIDE)] = ()
    cameras: PairNames = None
    second: Annotated[
        Path | None,
        Option(
            "Second file of the rig: the other camera's of ROS, extrinsics.yml of OpenCV.",
            metavar="FILE",
            group=INPUT,
            names="--with",
        ),
    ] = None
    given: Annotated[GivenCamera, Without(("camera_matrix", "distortion", "size"))] = field(default_factory=GivenCamera)
    view: RectifiedViewOptions = field(default_factory=RectifiedViewOptions)
    interpolation: Annotated[
        str,
        Option("nearest (rounded), linear, cubic, lanczos. Linear is geometrically the most accurate.", metavar="NAME"),
    ] = "linear"
    maps: Annotated[
        bool,
        Option("Also write maps.npz: float32 maps for cv2.remap and valid masks.", group=OUTPUT, recorded=False),
    ] = False
    opencv: Annotated[
        bool, Option("Also write opencv.yml: R1 R2 P1 P2 Q (pinhole only).", group=OUTPUT, recorded=False)
    ] = False
    ros: Annotated[
        bool,
        Option(
            "Also write camera_info files to a folder ros (pinhole only); images have the size of the camera's.",
            group=OUTPUT,
        ),
    ] = False
    format: PictureFormat = None
    quality: JpegQuality = JPEG_QUALITY
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.left) != bool(self.right):
            raise InvalidInput("LEFT and RIGHT go together: give both, or neither for maps and files only")


POINTS, FILTERS = "Points", "Which pixels"


@dataclass(frozen=True)
class PointOptions(OptionsRecord):
    """Which pixels become points. See `stereo.selection.Selection` for what is not said here.

    min_depth, max_depth: metres. crop: xmin, xmax, ymin, ymax, zmin, zmax, metres. mask: an image, not zero where
    points are wanted. max_sigma: largest standard deviation of the depth, as a share of it. min_confidence: a number or
    a name of `Confidence`. sigma_disparity: pixels, for all pixels alike. outliers: organised, radius, radius:METRES or
    none. voxel: side, metres.
    """

    min_depth: Annotated[float, Option("Minimum depth.", metavar="METRES", group=FILTERS)] = 0.0
    max_depth: Annotated[float, Option("Maximum depth.", metavar="METRES", group=FILTERS)] = float("inf")
    crop: Annotated[
        tuple[float, ...] | None,
        Option(
            "Bounding box xmin,xmax,ymin,ymax,zmin,zmax: metres, in the output frame.",
            metavar="BOX",
            group=FILTERS,
            type=NUMBERS,
        ),
    ] = None
    mask: Annotated[
        Path | None, Option("Mask image: keep pixels where it is not zero.", metavar="IMAGE", group=FILTERS)
    ] = None
    max_sigma: Annotated[
        float | None,
        Option(
            "Largest relative standard deviation of the depth.",
            metavar="PERCENT",
            group=FILTERS,
            type=PERCENT,
        ),
    ] = None
    min_confidence: Annotated[
        str | None,
        Option(
            "Lowest confidence class: filled, single, apart, near, agreed; or 1 to 5.",
            metavar="CLASS",
            group=FILTERS,
        ),
    ] = None
    stride: Annotated[int, Option("Subsample: every N-th pixel of every N-th row.", metavar="N", group=FILTERS)] = 1
    outliers: Annotated[
        str,
        Option(
            "Remove isolated points: organised (fewer than 6 of 24 adjacent pixels within 1 px), "
            "radius:METRES (fewer than 6 points), or none.",
            metavar="METHOD",
            group=FILTERS,
        ),
    ] = "organised"
    voxel: Annotated[
        float | None,
        Option("Voxel grid filter: one mean point per cube of this side.", metavar="METRES", group=FILTERS),
    ] = None
    max_points: Annotated[
        int | None, Option("Maximum number of points (random sample).", metavar="N", group=FILTERS)
    ] = None
    sigma_disparity: Annotated[
        float | None,
        Option(
            "Standard deviation of the disparity; by default the image the sidecar names.",
            metavar="PIXELS",
            group=INPUT,
        ),
    ] = None


@dataclass(frozen=True)
class VertexOptions(OptionsRecord):
    """What is said of a point, and where.

    frame: see `stereo.depth`, None for the left camera as it was before camcal rectified its images. unit: see
    there. pose: file of the camera's place.
    """

    frame: Annotated[
        str | None,
        Option(
            "camera (the left camera before rectification: the default where camcal rectified the images), optical "
            "(the rectified left camera: x right, y down, z forward), ros, opengl.",
            metavar="NAME",
            group=POINTS,
        ),
    ] = None
    unit: Annotated[str, Option("Unit of the coordinates.", metavar="m|mm", group=POINTS)] = "m"
    pose: Annotated[
        Path | None,
        Option(
            "world_T_camera (4 x 4 numbers or a TUM line), to write points in the world frame; --frame enu for one "
            "of east, north and up.",
            metavar="FILE",
            group=POINTS,
        ),
    ] = None
    normals: Annotated[bool, Option("Write surface normals.", group=POINTS)] = False
    sigma: Annotated[bool, Option("Write the standard deviation of the depth.", group=POINTS)] = False
    organised: Annotated[
        bool, Option("Write an organised cloud with one point per pixel, NaN where there is none (.pcd).", group=OUTPUT)
    ] = False
    ascii_text: Annotated[bool, Option("Write PLY or PCD as text.", group=OUTPUT, names="--ascii")] = False


def _cloud_suffixes() -> tuple[str, ...]:
    from camcal.formats import pointclouds

    return pointclouds.SUFFIXES


@dataclass(frozen=True)
class CloudOptions(OptionsRecord):
    """A disparity map, the left image, and where the geometry comes from; or an unrectified pair and its rig.

    image, camera_file: the left image and the camera file (FILE or FILE#NAME), either or both, distinguished by the
    suffix; what is not given is taken from the sidecar of the map. Where the camera file is of cameras that are not
    rectified, disparity and image are the left and the right image, matched as `matching` says. scale: counts of the
    file per pixel of disparity, None by its type.
    """

    disparity: Annotated[
        Path,
        Argument(
            "Disparity map of the left image: PFM, TIFF, PNG, NPY, NPZ, EXR; or a folder. Or the left image of an "
            "unrectified pair: LEFT RIGHT RIG.",
            metavar="DISPARITY",
        ),
    ]
    output: Annotated[Path, result_option(Written(_cloud_suffixes, folder=True))]
    image: Annotated[
        str | None,
        Argument("The rectified left image, for colour; or the right image of an unrectified pair.", metavar="IMAGE"),
    ] = None
    camera_file: PairCamera = None
    geometry: Annotated[GeometryOptions, Without(("given.part.crop",))] = field(  # --crop is of the cloud
        default_factory=GeometryOptions
    )
    scale: Annotated[
        float | None,
        Option(
            "Counts per pixel of disparity; by default from the sidecar, or 256 for 16-bit (signed: 16), else 1.",
            metavar="COUNTS",
            group=INPUT,
        ),
    ] = None
    matching: MatchOptions = field(default_factory=MatchOptions)
    points: PointOptions = field(default_factory=PointOptions)
    vertices: VertexOptions = field(default_factory=VertexOptions)
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    overwrite: Overwrite = False

    @property
    def files(self) -> tuple[str, ...]:
        """The image and the camera file, as far as they are given."""
        return tuple(text for text in (self.image, self.camera_file) if text is not None)


CLOUD_TYPES = ("ply", "pcd", "xyz", "npz", "glb", "las", "laz")
_READING = ("pattern", "algorithm", *(f"layout.{each}" for each in ("format", "size", "stride", "offset", "endian")))
_CALIBRATION = (
    "output",
    "tolerance",
    "timing.source",
    "timing.fps",
    "timing.unit",
    "lenses",
    "guess",
    *(f"part.{each.name}" for each in fields(ImagePart)),
    "free_corners",
    "max_rejected",
    "report",
    "image_size",
    "recursive",
    "jobs",
    *(f"batch.{each.name}" for each in fields(BatchOptions)),
    *(f"reading.{each}" for each in (*_READING, "layout.align")),
    "frames.most",
    "frames.every",
    "frames.whole",
    "refine",
    "motion",
    "mixed_sizes",
    "save_detections",
    "max_uncertainty",
    "figures.folder",
    "figures.kind",
    "overwrite",
)  # of the rig's settings, what `stereo calibrate` is for


@dataclass(frozen=True)
class RunOptions(OptionsRecord):
    """A rig and pairs, or pairs of a board to calibrate it with; which pairs become clouds, and how.

    inputs: RIG LEFT RIGHT, or LEFT RIGHT with a board. scene: other images of the cameras than those of the board.
    every: use of every so many pairs one. clouds: type of the files.
    """

    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "A rig file and the images of its cameras, each a file, a folder, a quoted glob or a video; without the "
            "rig file images of a board (--board), which the cameras are calibrated with first.",
            metavar="[RIG] LEFT RIGHT",
            required=True,
        ),
    ] = ()
    output: Annotated[Path, output_option("Folder for all results.", FOLDER, "DIR", required=True)] = Path()
    scene: Annotated[
        tuple[str, ...] | None,
        Option(
            "Images of the scene, where LEFT and RIGHT show a board; by default the scene is what is behind the board.",
            metavar="LEFT RIGHT",
            group=INPUT,
            values=2,
        ),
    ] = None
    every: Annotated[
        int, Option("Use one of every N pairs; of videos, one of every N frames.", metavar="N", group=INPUT, least=1)
    ] = 1
    cameras: PairNames = None
    part: Annotated[ImagePart, Without(("crop",))] = WHOLE  # --crop is of the clouds
    settings: Annotated[RigSettings, Without(_CALIBRATION)] = field(default_factory=RigSettings)
    view: RectifiedViewOptions = field(default_factory=RectifiedViewOptions)
    matching: MatchOptions = field(default_factory=MatchOptions)
    points: Annotated[PointOptions, Without(("mask", "sigma_disparity"))] = field(default_factory=PointOptions)
    vertices: Annotated[VertexOptions, Without(("organised", "pose", "ascii_text"))] = field(
        default_factory=VertexOptions
    )
    clouds: Annotated[
        str,
        Option(f"Type of the clouds: {', '.join(CLOUD_TYPES)}.", metavar="TYPE", group=OUTPUT, choices=CLOUD_TYPES),
    ] = "ply"
    force: Force = False
    recursive: Recursive = False
    jobs: Jobs = None
    batch: BatchOptions = DEFAULT_BATCH
    overwrite: Overwrite = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.inputs:
            return
        if len(self.inputs) not in (2, 3):
            raise InvalidInput(f"expected [RIG] LEFT RIGHT, found {len(self.inputs)} arguments: quote globs")
        if self.rig is not None and len(self.inputs) == 2:
            raise InvalidInput(f"expected LEFT RIGHT after the rig file, found {self.inputs[1]} alone")
        if len(self.inputs) == 3 and self.rig is None:
            raise InvalidInput(f"a rig file ends in {', '.join(CAMERA_SUFFIXES)}", where=self.inputs[0])
        if self.rig is None and self.settings.board is None:
            raise InvalidInput(
                "no rig file: camcal stereo calibrate LEFT RIGHT --board BOARD -o rig.yaml makes one; put it before "
                "LEFT RIGHT, or give --board if they show one"
            )
        if self.rig is not None and self.settings.board is not None:
            raise InvalidInput("--board calibrates the cameras, which the rig file is for already: leave one out")
        if self.rig is not None and self.scene is not None:
            raise InvalidInput("--scene goes with --board; with a rig file LEFT and RIGHT are the scene")
        if self.vertices.frame == "enu":
            raise InvalidInput("--frame enu needs a pose for every pair: use 'camcal stereo cloud --pose FILE'")

    @property
    def rig(self) -> str | None:
        """The rig file, FILE or FILE#LEFT,RIGHT; None if the cameras are to be calibrated."""
        first = self.inputs[0].rpartition("#")[0] or self.inputs[0]
        return self.inputs[0] if Path(first).suffix.lower() in CAMERA_SUFFIXES else None

    @property
    def pairs(self) -> tuple[str, str]:
        """The left and the right images that become clouds."""
        left, right = self.scene or self.inputs[-2:]
        return left, right
