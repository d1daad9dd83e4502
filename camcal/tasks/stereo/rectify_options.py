"""The options of `camcal stereo rectify`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from camcal.errors import InvalidInput
from camcal.images.options import JPEG_QUALITY
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Without
from camcal.run.options import DEFAULT_BATCH, BatchOptions
from camcal.stereo.rectify.options import RectifiedViewOptions
from camcal.tasks.options import (
    FOLDER,
    GivenCamera,
    Jobs,
    JpegQuality,
    Overwrite,
    PictureFormat,
    Recursive,
    output_option,
)
from camcal.tasks.stereo.options import ONE_SIDE, PairNames


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
