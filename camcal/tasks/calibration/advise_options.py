"""The options of `camcal advise`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from camcal.options import METHOD, Argument, Option, OptionsRecord
from camcal.tasks.options import FIGURES, BoardText, DetectionsModel, DetectionsSize, Overwrite, output_option


@dataclass(frozen=True)
class AdviseOptions(OptionsRecord):
    """A camera file or a detections file, how many views to suggest, and where their picture goes.

    board: of detections that name none, or another one than that of the calibration. model, image_size: of detections,
    as for `calibrate`.
    """

    file: Annotated[
        str, Argument("Camera file of camcal, or FILE#NAME, or detections file.", metavar="CAMERA|DETECTIONS")
    ]
    board: BoardText = None
    model: DetectionsModel = None
    image_size: DetectionsSize = None
    count: Annotated[
        int, Option("Number of views to suggest.", metavar="N", names="--views", group=METHOD, least=1, most=20)
    ] = 3
    output: Annotated[Path | None, output_option("Picture of the suggested views.", FIGURES, "FILE")] = None
    overwrite: Overwrite = False
