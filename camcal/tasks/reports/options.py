"""The options of `camcal report` and `camcal rerun`."""

from pathlib import Path
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.options import Argument, OptionsRecord
from camcal.tasks.options import FOLDER, PAGE, BoardText, DetectionsModel, DetectionsSize, Overwrite, output_option


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
