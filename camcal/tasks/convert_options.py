"""The options of `camcal convert`."""

from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass, field
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Without, Written
from camcal.tasks.options import CAMERA_SUFFIXES, FIGURES, CameraName, GivenCamera, Overwrite
from camcal.tasks.suggestions import camera_formats, format_names, lens_model_names, lens_models


@dataclass(frozen=True)
class ConvertFileOptions(OptionsRecord):
    """A camera file of any format (FILE or FILE#NAME), where it goes, and the format it gets; None as suffixes say.

    second: the other file of a pair that is written as two. given: what the file does not say. refit: the lens model
    that lenses are to have. max_error_px: how far off a lens may be that the format does not have, pixels; None: it has
    to be exact. max_theta_deg: up to which angle from the axis.
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
    refit: Annotated[
        str | None,
        Option(
            lambda: f"Write the nearest lens of this model: {lens_models()}.",
            metavar="MODEL",
            group=OUTPUT,
            suggested=lens_model_names,
        ),
    ] = None
    max_error_px: Annotated[
        float | None,
        Option(
            "How far off the nearest lens may be anywhere in the image, where the format does not have the lens model. "
            "By default lenses are exact or refused; 0.1 with --refit.",
            metavar="PX",
            group=OUTPUT,
            names="--max-error",
            least=0,
        ),
    ] = None
    max_theta_deg: Annotated[
        float | None,
        Option(
            "The nearest lens need only be near up to this angle from the axis.",
            metavar="DEGREES",
            group=OUTPUT,
            names="--max-theta",
            least=1,
        ),
    ] = None
    plot: Annotated[
        Path | None,
        Option(
            "Draw the map of the difference of the nearest lens.",
            metavar="FILE",
            group=OUTPUT,
            recorded=False,
            written=FIGURES,
        ),
    ] = None
    given: Annotated[GivenCamera, Without(("camera_matrix", "distortion"))] = field(default_factory=GivenCamera)
    camera: CameraName = None
    overwrite: Overwrite = False
