"""What a result file is, and the figures of it."""

from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from camcal import files
from camcal.errors import FileError, InvalidInput
from camcal.formats import cameras, detections, disparity, poses, trajectories
from camcal.formats import series as series_files
from camcal.formats.documents import load_either
from camcal.formats.poses import plain as plain_poses
from camcal.formats.tables import read_measurements
from camcal.formats.trajectories import native as native_trajectories
from camcal.formats.trajectories import tracked
from camcal.progress import Progress
from camcal.report.figures.camera_files import camera_file_plots, detection_plots, pose_plots
from camcal.report.figures.disparity_errors import disparity_map
from camcal.report.figures.figure import Plot, of_part
from camcal.report.figures.over_time import Panel, over_time
from camcal.report.figures.trajectories import path_of, trajectory_plots
from camcal.tasks.plot_documents import FIT, SENSOR, fit_file_plots, sensor_file_plots
from camcal.tasks.plot_json import command_of, printed_plots
from camcal.tasks.rigs.inspect_rig import inspect_rig

KINDS = (
    "camera and rig files, detections (.csv, .vnl), poses, trajectories (.tum, .txt, .csv, .yaml, .json), tracks, "
    "smoothed series (.csv), disparity maps (.png, .tiff, .pfm, .exr, .npz), sensor files, fits, what calibrate, "
    "detect, pnp and fit print with --json"
)
_MAPS = (".png", ".tif", ".tiff", ".pfm", ".exr", ".npz", ".npy")
_TEXTS = (".csv", ".vnl", ".tum", ".txt", ".kitti", ".yaml", ".yml", ".json", ".xml")
_HEAD = 4096


@dataclass(frozen=True, eq=False)
class Drawable:
    """A file, what it is, and its figures."""

    path: Path
    kind: str
    plots: tuple[Plot, ...]


def drawable(path: Path, reference: Path | None, progress: Progress) -> Drawable:
    """Return what a file is with its figures; reference: a trajectory that a trajectory is compared with.

    Raises FileError for a file of no kind that can be drawn, and as the readers of the kinds do.
    """
    suffix = files.suffix_of(path)
    if suffix in _MAPS:
        return Drawable(path, "disparity", (disparity_map(disparity.read(path).matched()),))
    if suffix not in _TEXTS:
        raise _unknown(path)
    if suffix == ".vnl":
        return Drawable(path, "detections", detection_plots(detections.read(path)))
    if suffix in (".tum", ".txt", ".kitti"):
        return _trajectory(path, reference)
    if suffix == ".csv":
        return _table(path, reference)
    if suffix == ".xml" or cameras.is_camera_file(path):
        return _camera(path, progress)
    return _document(path, reference, progress)


def _unknown(path: Path) -> FileError:
    return FileError(f"is no result that can be drawn; these are {KINDS}", where=str(path))


def _table(path: Path, reference: Path | None) -> Drawable:
    head = files.read_text(path)[:_HEAD]
    first = head.split("\n", 1)[0]
    if first.startswith(detections.MAGIC) or first.split(",")[:4] == list(detections.COLUMNS[:4]):
        return Drawable(path, "detections", detection_plots(detections.read(path)))
    if first.startswith(f"# {plain_poses.FORMAT} "):
        return Drawable(path, "poses", pose_plots(poses.read(path)))
    if first.startswith(f"# {series_files.FORMAT} "):
        return Drawable(path, "series", (_series(path),))
    if first.startswith(f"# {tracked.FORMAT} ") or trajectories.is_trajectory_csv(path):
        return _trajectory(path, reference)
    raise _unknown(path)


def _trajectory(path: Path, reference: Path | None) -> Drawable:
    truth = None if reference is None else trajectories.read_reference(reference)[0]
    objects = trajectories.read_objects(path)
    if len(objects) == 1:
        return Drawable(path, "trajectory", trajectory_plots(path_of(next(iter(objects.values())), truth)))
    plots = [of_part(trajectory_plots(path_of(own, truth)), name) for name, own in objects.items()]
    return Drawable(path, "tracks", tuple(chain.from_iterable(plots)))


def _camera(path: Path, progress: Progress) -> Drawable:
    file = cameras.read(path, progress)
    rig = inspect_rig(file, str(path))
    if rig is None:
        return Drawable(path, "camera", camera_file_plots(file))
    return Drawable(path, "rig", camera_file_plots(file, rig.rig, rig.boards, rig.board))


def _document(path: Path, reference: Path | None, progress: Progress) -> Drawable:
    content = load_either(path)
    if command := command_of(content):
        return Drawable(path, f"{command} --json", printed_plots(content, command))
    form = content.get("format")
    if form == plain_poses.FORMAT:
        return Drawable(path, "poses", pose_plots(poses.read(path)))
    if form in (native_trajectories.FORMAT, tracked.FORMAT) or native_trajectories.TRANSFORMS in content:
        return _trajectory(path, reference)
    if form == SENSOR:
        return Drawable(path, "sensor", sensor_file_plots(content))
    if form == FIT:
        return Drawable(path, "fit", fit_file_plots(content))
    if cameras.is_camera_file(path):
        return _camera(path, progress)
    raise _unknown(path)


def _series(path: Path) -> Plot:
    """Return the states of a smoothed series with their standard deviations."""
    table = read_measurements(path)
    time, *names = table.columns
    states = [name for name in names if f"std_{name}" in table.columns]
    if not states:
        raise InvalidInput("holds no states with standard deviations", where=str(path))
    stamps, none = table.numbers(time), np.zeros(0)
    return over_time(
        [
            Panel(
                name,
                (stamps, table.numbers(name), table.numbers(f"std_{name}")),
                (none, none),
                np.zeros(0, bool),
            )
            for name in states
        ]
    )
