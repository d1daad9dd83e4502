"""The options of `camcal stereo cloud`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from camcal.options import INPUT, NUMBERS, OUTPUT, PERCENT, Argument, Option, OptionsRecord, Written
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.stereo.options import MatchOptions
from camcal.tasks.options import Jobs, Overwrite, result_option
from camcal.tasks.stereo.options import GeometryOptions, PairCamera

POINTS, FILTERS = "Points", "Which pixels"


@dataclass(frozen=True)
class PointOptions(OptionsRecord):
    """Which pixels become points. See `stereo.points.selection.Selection` for what is not said here.

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

    frame: see `stereo.points.frames`, None for the left camera as it was before camcal rectified its images. unit: see
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
    geometry: GeometryOptions = field(default_factory=GeometryOptions)
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
