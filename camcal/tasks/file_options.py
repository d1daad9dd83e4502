"""The options of the commands that take finished files: `camcal inspect`, `plot`, `convert`, `report`, `rerun`."""

from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass, field
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Without, Written
from camcal.raw.options import NO_LAYOUT, GivenLayout
from camcal.tasks.gates import NO_GATES, NOWHERE, CameraGates, MeasuredAt
from camcal.tasks.options import (
    CAMERA_SUFFIXES,
    FIGURE_TYPES,
    FIGURES,
    FOLDER,
    PAGE,
    THEMES,
    WHOLE,
    BoardText,
    CameraName,
    DetectionsModel,
    DetectionsSize,
    FigureType,
    GivenCamera,
    ImagePart,
    Overwrite,
    Pattern,
    camera_formats,
    format_names,
    lens_model_names,
    lens_models,
    output_option,
)


@dataclass(frozen=True)
class InspectOptions(OptionsRecord):
    """A camera file, or FILE#NAME for one of its cameras; or a raw frame, its pattern and layout as far as needed.

    get: the path of one value in a camera file. output: a picture of the rig, or a page that shows it. gates: what the
    cameras of the file must be. measured: where the errors of measurements are asked for.
    """

    file: Annotated[
        str,
        Argument(
            "A camera file, or FILE#NAME for one of several cameras; or a raw frame: of a camera (.dng, .cr2, …), "
            "a bare mosaic (PNG, TIFF, PGM, NPY), a dump of a sensor (.raw, .bin).",
            metavar="FILE",
        ),
    ]
    get: Annotated[
        str | None,
        Option(
            "Print one value only, such as cameras.left.intrinsics.fx (lists as JSON).", metavar="KEY", group=OUTPUT
        ),
    ] = None
    output: Annotated[
        Path | None,
        output_option(
            "Picture of a rig: cameras as frusta, and the boards that they saw. A page (.html) can be turned.",
            Written((".png", ".html")),
            metavar="FILE",
        ),
    ] = None
    camera: CameraName = None
    pattern: Pattern = None
    layout: GivenLayout = NO_LAYOUT
    gates: CameraGates = NO_GATES
    measured: MeasuredAt = NOWHERE
    part: ImagePart = WHOLE
    overwrite: Overwrite = False

    @property
    def address(self) -> tuple[Path, str | None]:
        """The file, and the camera in it that is meant; None for all of them."""
        from camcal.formats import split_address

        path, name = split_address(self.file)
        return path, self.camera or name


@dataclass(frozen=True)
class PlotOptions(OptionsRecord):
    """Result files, and where their figures go: a folder, or a file for a single one.

    figures: names of those that are wanted, none for all. reference: a trajectory that others are compared with.
    """

    inputs: Annotated[
        tuple[str, ...],
        Argument(
            "Results of camcal: camera and rig files, detections, poses, trajectories, tracks, series, disparity maps, "
            "sensor files, fits, some --json documents.",
            metavar="FILE…",
            required=True,
        ),
    ] = ()
    output: Annotated[
        Path | None,
        output_option(
            "Folder for the figures, with their captions in figures.md; or a file for one figure.",
            Written(FIGURES.known, folder=True),
            metavar="DIR|FILE",
            required=True,
        ),
    ] = None
    part: ImagePart = WHOLE
    kind: FigureType = FIGURE_TYPES[0]
    theme: Annotated[
        str, Option("Colours: dark on light, or light on dark.", metavar="|".join(THEMES), group=OUTPUT, choices=THEMES)
    ] = THEMES[0]
    figures: Annotated[
        tuple[str, ...],
        Option(
            "Name of a figure that is wanted; repeatable. By default all.",
            metavar="NAME",
            group=OUTPUT,
            names="--figure",
        ),
    ] = ()
    reference: Annotated[
        Path | None,
        Option(
            "Trajectory that the others are compared with, after alignment: figures show the errors.",
            metavar="FILE",
            group=INPUT,
        ),
    ] = None
    overwrite: Overwrite = False


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


@dataclass(frozen=True)
class ReportOptions(OptionsRecord):
    """A camera file, a rig file or a detections file, and where its report goes.

    board, model, image_size: of detections, as for `calibrate`.
    """

    file: Annotated[str, Argument("Camera file, rig file or detections file.", metavar="CAMERA|RIG|DETECTIONS")]
    output: Annotated[Path | None, output_option("Report, one HTML file.", PAGE, "FILE", required=True)] = None
    board: BoardText = None
    model: DetectionsModel = None
    image_size: DetectionsSize = None
    overwrite: Overwrite = False


@dataclass(frozen=True)
class RerunOptions(OptionsRecord):
    """A report, and the folder for the camera or rig file and the report that are made again."""

    file: Annotated[Path, Argument("Report written by camcal.", metavar="REPORT")]
    output: Annotated[
        Path, output_option("Folder for camera.yaml or rig.yaml and report.html.", FOLDER, "DIR", required=True)
    ]
    overwrite: Overwrite = False
