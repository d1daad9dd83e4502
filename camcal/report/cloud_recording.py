"""A cloud for the Rerun viewer, where it is installed."""

import importlib
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.files import replacing
from camcal.report.cloud_paint import Paint
from camcal.report.cloud_scene import CloudScene

SUFFIX = ".rrd"

_APPLICATION = "camcal view"
_IDENTIFIER = "camcal"  # the same in every run
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def require_rerun() -> Any:
    """Return the module of the Rerun SDK; raises InvalidInput, naming the extra, where it is not installed."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise InvalidInput("Rerun is not installed; pip install 'camcal[view]', or write .html instead") from error


def save(path: Path, scene: CloudScene, paint: Paint) -> None:
    """Write a recording of a cloud. Raises InvalidInput without the Rerun SDK, FileError if it cannot be written."""
    rerun = require_rerun()
    with replacing(path) as temporary:
        recording = rerun.RecordingStream(_APPLICATION, recording_id=_IDENTIFIER)
        recording.save(temporary)
        _log(rerun, recording, scene, paint)
        recording.flush()
        recording.disconnect()
        if not temporary.stat().st_size:
            raise FileError("Rerun wrote nothing", where=str(path))


def open_viewer(scene: CloudScene, paint: Paint) -> None:
    """Show a cloud in the Rerun viewer, which stays open. Raises InvalidInput without the Rerun SDK or a screen."""
    rerun = require_rerun()
    if sys.platform == "linux" and not any(map(os.environ.get, _SCREENS)):
        raise InvalidInput(f"there is no screen to open Rerun on; write for it with -o NAME{SUFFIX}")
    recording = rerun.RecordingStream(_APPLICATION, recording_id=_IDENTIFIER)
    try:
        recording.spawn()
        _log(rerun, recording, scene, paint)
        recording.flush()
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise InvalidInput(f"the Rerun viewer does not start: {reason} Write for it with -o NAME{SUFFIX}") from error


def _log(rerun: Any, recording: Any, scene: CloudScene, paint: Paint) -> None:
    spacing, grows = scene.spacing
    radius = 0.5 * spacing * (scene.median_depth if grows else 1.0)
    recording.log("cloud", getattr(rerun.ViewCoordinates, _axes(scene.view_T_cloud)), static=True)
    recording.log("cloud/points", rerun.Points3D(scene.points, colors=paint.colours, radii=abs(radius)), static=True)


def _axes(view_T_cloud: Array) -> str:
    """Return where x, y and z of a cloud point, as the first letters of right, left, down, up, forward and back."""
    pairs = ("RL", "DU", "FB")
    rows = np.abs(view_T_cloud).argmax(axis=0).tolist()
    return "".join(pairs[row][int(view_T_cloud[row, axis] < 0)] for axis, row in enumerate(rows))
