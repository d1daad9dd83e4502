"""`camcal plot`: figures of the files that other commands wrote, and of the documents that they print with --json.

What a file is follows from its suffix and its content.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.formats import cameras, detections, detections_text, disparity, poses, trajectories
from camcal.formats import series as series_files
from camcal.formats.documents import Document, load_either
from camcal.formats.poses import record as plain_poses
from camcal.formats.schema import flag, integer, items, mapping, number, text, unchecked
from camcal.formats.tables import read_measurements
from camcal.formats.trajectories import native as native_trajectories
from camcal.formats.trajectories import tracked
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.report.figures.calibration import ranked_views, residuals_by_view
from camcal.report.figures.disparity_errors import disparity_map
from camcal.report.figures.figure import THEMES, Plot, encoded, of_part
from camcal.report.figures.image_plane import projection_uncertainty
from camcal.report.figures.over_time import Panel, over_time
from camcal.report.figures.rig import camera_file_plots, detection_plots, pose_plots
from camcal.report.figures.trajectories import path_of, trajectory_plots
from camcal.run.outputs import writes
from camcal.run.paths import find_files
from camcal.tasks.figure_files import write_figures
from camcal.tasks.file_options import PlotOptions
from camcal.tasks.fit_report import FIT, SENSOR, fit_file_plots, require, sensor_file_plots, written
from camcal.tasks.given_camera import read_part, require_whole
from camcal.tasks.options import CAMERA_SUFFIXES, FIGURES, FigureOptions, ImagePart
from camcal.tasks.rigs.inspect_rig import inspect_rig

KINDS = (
    "camera and rig files, detections (.csv, .vnl), poses, trajectories (.tum, .txt, .csv, .yaml, .json), tracks, "
    "smoothed series (.csv), disparity maps (.png, .tiff, .pfm, .exr, .npz), sensor files, fits, what calibrate, "
    "detect, pnp and fit print with --json"
)
_MAPS = (".png", ".tif", ".tiff", ".pfm", ".exr", ".npz", ".npy")
_TEXTS = (".csv", ".vnl", ".tum", ".txt", ".kitti", ".yaml", ".yml", ".json", ".xml")
_HEAD = 4096

_SCHEMA = re.compile(r"camcal/(?P<command>[a-z-]+)/\d+")
_ROWS = items(items(unchecked))
_MAP = mapping({"u": items(number()), "v": items(number()), "rms_px": _ROWS, "worst_px": _ROWS, "inside": unchecked})
_VIEW = mapping({"file": text, "used": flag}, {"rms_px": number(0)}, others=unchecked)
_CALIBRATION = mapping(
    {
        "image_size": items(integer(1), 2),
        "uncertainty": mapping({"map": _MAP}, others=unchecked),
        "views": items(_VIEW),
    },
    others=unchecked,
)
_NOT_OF_A_POSE_FILE = ("schema", "failed", "pictures", "warnings")
_DETECTION = mapping(
    {"images": items(mapping({"image": text, "corners": integer(0)}, others=unchecked))}, others=unchecked
)


@dataclass(frozen=True, eq=False)
class Drawable:
    """A file, what it is, and its figures."""

    path: Path
    kind: str
    plots: tuple[Plot, ...]


@dataclass(frozen=True, eq=False)
class PlotReport:
    """What was drawn, by the files it is of, and the files that were written."""

    drawn: tuple[Drawable, ...]
    figures: tuple[Path, ...]


@writes
def plot(options: PlotOptions, progress: Progress = SILENT) -> PlotReport:
    """Return what was drawn, after writing it to options.output.

    Raises FileError for a file that is not there or of no kind that can be drawn, InvalidInput for a figure that there
    is none of, or where one file is named for several; nothing is written then.
    """
    found = tuple(drawable(path, options, progress) for path in find_files(options.inputs))
    if not any(each.kind in ("camera", "rig") for each in found):
        require_whole(options.part, "a camera file")
    plots = _choose_plots(_name_plots(found), options.figures)
    output = options.output
    if output is None:
        return PlotReport(found, ())
    if output.suffix.lower() in FIGURES.known and not output.is_dir():
        if len(plots) > 1:
            names = ", ".join(each.name for each in plots)
            raise InvalidInput(
                f"takes one figure, there are {len(plots)}: choose one with --figure ({names}), or name a folder",
                where=str(output),
            )
        files.write_bytes(output, encoded(plots[0], output.suffix, THEMES[options.theme]))
        return PlotReport(found, (output,))
    return PlotReport(found, write_figures(FigureOptions(output, options.kind), plots, options.theme))


def _name_plots(found: Sequence[Drawable]) -> list[Plot]:
    """Return all figures; those of several files have the names of their files before their own."""
    if len(found) == 1:
        return list(found[0].plots)
    stems = [each.path.stem for each in found]
    names = [stem if stems.count(stem) == 1 else f"{number}_{stem}" for number, stem in enumerate(stems, 1)]
    return [own for each, name in zip(found, names, strict=True) for own in of_part(each.plots, name)]


def _choose_plots(plots: Sequence[Plot], wanted: Sequence[str]) -> list[Plot]:
    """Return the figures that are wanted, all where none are named."""
    names = [each.name for each in plots]
    for name in wanted:
        if name not in names:
            raise InvalidInput(
                f"--figure {name}: no such figure{did_you_mean(name, names)}; there are {', '.join(names)}"
            )
    return [each for each in plots if not wanted or each.name in wanted]


def document(report: PlotReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "inputs": [{"file": each.path.as_posix(), "kind": each.kind} for each in report.drawn],
        "figure_files": [path.as_posix() for path in report.figures],
        "captions": {own.name: own.caption for each in report.drawn for own in each.plots},
    }


def drawable(path: Path, options: PlotOptions, progress: Progress) -> Drawable:
    """Return what a file is with its figures.

    Raises FileError for a file of no kind that can be drawn, and as the readers of the kinds do.
    """
    suffix, reference = files.suffix_of(path), options.reference
    if suffix in _MAPS:
        return Drawable(path, "disparity", (disparity_map(disparity.read(path).matched()),))
    if suffix in CAMERA_SUFFIXES and (suffix not in _TEXTS or suffix == ".txt") and cameras.is_camera_file(path):
        return _camera(path, options.part, progress)
    if suffix not in _TEXTS:
        raise _unknown(path)
    if suffix in (".tum", ".txt", ".kitti"):
        return _trajectory(path, reference)
    if suffix in (".csv", ".vnl"):
        return _table(path, reference)
    if suffix == ".xml" or cameras.is_camera_file(path):
        return _camera(path, options.part, progress)
    return _document(path, options, progress)


def _unknown(path: Path) -> FileError:
    return FileError(f"is no result that can be drawn; these are {KINDS}", where=str(path))


def _table(path: Path, reference: Path | None) -> Drawable:
    head = files.read_text(path)[:_HEAD]
    first = head.split("\n", 1)[0]
    if (
        files.suffix_of(path) == ".vnl"
        or first.startswith(detections_text.MAGIC)
        or first.split(",")[:4] == list(detections_text.COLUMNS[:4])
    ):
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


def _camera(path: Path, part: ImagePart, progress: Progress) -> Drawable:
    file = read_part(path, part, progress, central=False)
    rig = inspect_rig(file, str(path))
    if rig is None:
        return Drawable(path, "camera", camera_file_plots(file))
    return Drawable(path, "rig", camera_file_plots(file, rig.rig, rig.boards, rig.board))


def _document(path: Path, options: PlotOptions, progress: Progress) -> Drawable:
    content = load_either(path)
    if printed := _SCHEMA.fullmatch(str(content.get("schema", ""))):
        command = printed["command"]
        return Drawable(path, f"{command} --json", printed_plots(content, command))
    form = content.get("format")
    if form == plain_poses.FORMAT:
        return Drawable(path, "poses", pose_plots(poses.read(path)))
    if form in (native_trajectories.FORMAT, tracked.FORMAT) or native_trajectories.TRANSFORMS in content:
        return _trajectory(path, options.reference)
    if form == SENSOR:
        return Drawable(path, "sensor", sensor_file_plots(content))
    if form == FIT:
        return Drawable(path, "fit", fit_file_plots(content))
    if cameras.is_camera_file(path):
        return _camera(path, options.part, progress)
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


def printed_plots(content: Document, command: str) -> tuple[Plot, ...]:
    """Return the figures of what a command printed.

    Raises FileError for the document of a failure, or of a command whose figures are those of its files; InvalidInput
    for its faults.
    """
    if "error" in content:
        raise FileError(f"holds the failure of camcal {command}, nothing to draw", where=content.where)
    if command not in _PLOTS:
        known = ", ".join(_PLOTS)
        raise FileError(
            f"is what camcal {command} prints with --json: draw the files that it wrote (of --json, {known} are drawn)",
            where=content.where,
        )
    return _PLOTS[command](content)


def _calibration(content: Document) -> tuple[Plot, ...]:
    require(content, _CALIBRATION)
    width, height = content["image_size"]
    rows = [(view["file"], float(view["rms_px"]), view["used"]) for view in content["views"] if "rms_px" in view]
    of_views = (residuals_by_view(rows, len(content["views"])),) if any(used for *_, used in rows) else ()
    return (projection_uncertainty(_uncertainty(content), (width, height)), *of_views)


def _uncertainty(content: Document) -> ProjectionUncertainty:
    found = content["uncertainty"]["map"]
    u, v = (np.array(found[name], float) for name in ("u", "v"))
    rms, worst = (_grid(content, found, name, float) for name in ("rms_px", "worst_px"))
    if not (np.isfinite(rms) & np.isfinite(worst)).any():
        raise InvalidInput("uncertainty.map: holds no numbers to draw", where=content.where)
    # ellipses with these axes, in whatever direction: neither is drawn
    covariances = np.zeros((len(rms), 2, 2))
    covariances[:, 0, 0], covariances[:, 1, 1] = worst**2, np.maximum(2 * rms**2 - worst**2, 0)
    inside = None if found["inside"] is None else _grid(content, found, "inside", bool)
    return ProjectionUncertainty(u, v, covariances, inside)


def _grid(content: Document, found: Mapping[str, Any], name: str, kind: type) -> Array:
    """Return the values (N,) of a map, row by row; NaN where it has none."""
    values: Array = np.zeros(0)
    with suppress(TypeError, ValueError):
        values = np.array(found[name], kind)
    if values.shape != (len(found["v"]), len(found["u"])):
        raise InvalidInput(f"uncertainty.map.{name}: not a number for each of v and u", where=content.where)
    return values.ravel()


def _detection(content: Document) -> tuple[Plot, ...]:
    require(content, _DETECTION)
    if not content["images"]:
        raise InsufficientData("holds no images to draw", where=content.where)
    return (ranked_views([(image["image"], image["corners"]) for image in content["images"]]),)


def _poses(content: Document) -> tuple[Plot, ...]:
    data = {key: value for key, value in content.data.items() if key not in _NOT_OF_A_POSE_FILE}
    file = replace(content, data=data)
    require(file, plain_poses.check)
    return pose_plots(plain_poses.from_document(file))


def _fit(content: Document) -> tuple[Plot, ...]:
    return fit_file_plots(replace(content, data=written(content.data)))


_PLOTS: dict[str, Callable[[Document], tuple[Plot, ...]]] = {
    "calibrate": _calibration,
    "detect": _detection,
    "pnp": _poses,
    "fit": _fit,
}
