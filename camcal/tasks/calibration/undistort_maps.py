"""`camcal undistort --maps`: where the pixels of an undistorted view come from, for other programs to draw it."""

from pathlib import Path
from typing import Any

import numpy as np

from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.formats.maps import mesh_nodes, write_maps, write_mesh
from camcal.images.remap import build_maps
from camcal.images.views import make_view
from camcal.options import command_line
from camcal.progress import SILENT, Progress
from camcal.run.outputs import claim, writes
from camcal.tasks.calibration.undistort import move_pixels, read_source, write_view
from camcal.tasks.calibration.undistort_options import UndistortOptions

MESH_SUFFIX = ".txt"


@dataclass(frozen=True, eq=False)
class MapsReport:
    """What was written, how it is used, and the share of pixels that have a source.

    camera_file: the camera of the view, None for the way back.
    """

    output: Path
    camera_file: Path | None
    usage: str
    view: Camera
    valid: float


@writes
def undistort_maps(options: UndistortOptions, progress: Progress = SILENT) -> MapsReport:
    """Return what was written to options.output: the map of the view, or the way back.

    Raises InvalidInput for a view that the camera cannot give, or that the format cannot hold; FileError.
    """
    source = read_source(options, lambda: options.view.size, progress)
    output = options.output
    camera_file = None if options.distort else output.with_suffix(".camera.yaml")
    claim([output] if camera_file is None else [output, camera_file])
    view = make_view(source.camera, options.view, source.circle)
    lens, drawn = (view, source.camera) if options.distort else (source.camera, view)
    circle = None if options.distort else source.circle
    if output.suffix.lower() == MESH_SUFFIX:
        nodes = mesh_nodes(drawn.image_size, options.mesh_step)
        sources = move_pixels(drawn, lens, nodes.reshape(-1, 2)).reshape(nodes.shape)
        usage = write_mesh(output, nodes, sources, options.mesh_step)
        valid = float(np.mean((sources >= 0) & (sources <= np.array(lens.image_size) - 1)))
    else:
        maps = build_maps(lens, drawn, circle=circle)
        usage, valid = write_maps(output, maps), float(np.mean(maps.valid()))
    if camera_file is not None:
        write_view(camera_file, source, view, command_line("undistort", options), progress)
    return MapsReport(output, camera_file, usage, view, valid)


def maps_document(report: MapsReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {"output": report.output, "camera_file": report.camera_file, "usage": report.usage, "valid": report.valid}
