"""The options of `camcal convert`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Without, Written
from camcal.tasks.options import CAMERA_SUFFIXES, CameraName, GivenCamera, Overwrite
from camcal.tasks.suggestions import camera_formats, format_names


@dataclass(frozen=True)
class ConvertFileOptions(OptionsRecord):
    """A camera file of any format (FILE or FILE#NAME), where it goes, and the format it gets; None as suffixes say.

    second: the other file of a pair that is written as two. given: what the file does not say. max_error_px: how far
    off a lens may be that the format does not have, pixels; None: it has to be exact.
    """

    source: Annotated[
        str, Argument("Camera file of camcal or another program, or FILE#NAME for one camera of it.", metavar="IN")
    ]
    outputs: Annotated[
        tuple[Path, ...],
        Argument(
            "The files to write; a folder for a pair in ROS's format, or a rig in mrcal's.",
            metavar="OUT…",
            group=OUTPUT,
            recorded=False,
            written=Written(CAMERA_SUFFIXES, folder=True, stdout=True),
        ),
    ]
    to: Annotated[str | None, Option(camera_formats, metavar="FORMAT", group=OUTPUT, suggested=format_names)] = None
    second: Annotated[
        Path | None,
        Option(
            "Second file: the other camera's of ROS or mrcal, extrinsics.yml of OpenCV, rigs.txt of COLMAP.",
            metavar="FILE",
            group=INPUT,
            names="--with",
        ),
    ] = None
    max_error_px: Annotated[
        float | None,
        Option(
            "Where the format does not have the lens model: write the nearest one it has, if it is off by no more than "
            "this anywhere in the image. By default lenses are exact or refused.",
            metavar="PX",
            group=OUTPUT,
            names="--max-error",
            least=0,
        ),
    ] = None
    given: Annotated[GivenCamera, Without(("camera_matrix", "distortion"))] = field(default_factory=GivenCamera)
    camera: CameraName = None
    overwrite: Overwrite = False
