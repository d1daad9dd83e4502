"""The options of `camcal inspect` and `camcal plot`, which show what files hold."""

from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.options import INPUT, OUTPUT, Argument, Option, OptionsRecord, Written
from camcal.raw.options import NO_LAYOUT, GivenLayout
from camcal.tasks.gates import NO_GATES, CameraGates
from camcal.tasks.measured_at import NOWHERE, MeasuredAt
from camcal.tasks.options import (
    FIGURE_TYPES,
    FIGURES,
    THEMES,
    WHOLE,
    CameraName,
    FigureType,
    ImagePart,
    Overwrite,
    Pattern,
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
        from camcal.formats.addresses import split_address

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
