"""`camcal advise`: the views that a calibration would gain most from, and those that it could do without."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.cameras.model import require_central
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.formats import boards, cameras, split_address
from camcal.formats.camera_file import CameraFile
from camcal.geometry.pose import Pose
from camcal.messages import counted
from camcal.options import given_words
from camcal.progress import SILENT, Progress
from camcal.quality.range_uncertainty import CalibrationBoards
from camcal.quality.view_advice import Known, SuggestedView, ViewAdvice
from camcal.quality.view_advice import advise as best_views
from camcal.report.table import Column
from camcal.run.outputs import writes
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_views import OWN_SUFFIXES, is_table
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.camera_result import CalibrateReport
from camcal.tasks.calibration.options import AdviseOptions, CalibrateOptions
from camcal.tasks.given_camera import central_file

COLUMNS = (Column("view"), Column("pose of the board", wraps=True), Column("uncertainty, px"))
_SIDES = ("right", "lower right", "lower", "lower left", "left", "upper left", "upper", "upper right")
_SQUARE = 1.1  # of the sides of a board: whether it is upright cannot be seen on one that is nearly square


@dataclass(frozen=True, eq=False)
class AdviseReport:
    """What is known of the camera, and (found) what further views would do; output: the picture."""

    known: Known
    found: ViewAdvice
    output: Path | None = None


@writes
def advise(options: AdviseOptions, progress: Progress = SILENT) -> AdviseReport:
    """Return the views to take next of a camera file or a detections file, after drawing them to options.output.

    Detections are calibrated first. Raises InvalidInput, FileError, NotConverged, InsufficientData.
    """
    if is_table(options.file, OWN_SUFFIXES):
        how = CalibrateOptions((options.file,), board=options.board, model=options.model, image_size=options.image_size)
        known, seen = _of_calibration(calibrate(how, progress))
    else:
        if given := given_words(replace(options, board=None, count=AdviseOptions.count)):
            raise InvalidInput(f"{given[0]} applies to detections, not to a camera file", where=options.file)
        path, name = split_address(options.file)
        board = None if options.board is None else boards.load_board(options.board)
        known, seen = known_of_file(cameras.read(path, progress), str(path), name, board), []
    advice = best_views(known, options.count, seen)
    if options.output is not None:
        from camcal.report.figures.board import suggested_views
        from camcal.report.figures.figure import encoded

        corners = np.concatenate([view.pixels for view, _ in seen]) if seen else np.zeros((0, 2))
        plot = suggested_views(known, advice, corners, [pose_words(known, view) for view in advice.views])
        files.write_bytes(options.output, encoded(plot, options.output.suffix))
    return AdviseReport(known, advice, options.output)


def advise_views(
    calibration: CalibrateReport | CameraFile | Path | str, count: int = 3, board: Board | Path | str | None = None
) -> ViewAdvice:
    """Return the views that lower the projection uncertainty of a camera most, and those that may be left out.

    calibration: what `calibrate_camera` returned, or a camera file of camcal, FILE or FILE#NAME, or its content, of
    which the views are not known. count: of the views to suggest. board: a board, its file or its short form; None for
    that of the calibration. Raises InvalidInput where board, covariance or noise are not known, InsufficientData where
    no view of the board fits the image.
    """
    if isinstance(calibration, CalibrateReport):
        known, seen = _of_calibration(calibration)
        return best_views(known, count, seen)
    other = board if board is None or isinstance(board, Board) else boards.load_board(board)
    if isinstance(calibration, CameraFile):
        return best_views(known_of_file(calibration, "the camera file", None, other), count)
    path, name = split_address(str(calibration))
    return best_views(known_of_file(cameras.read(path), str(path), name, other), count)


def _of_calibration(report: CalibrateReport) -> tuple[Known, list[tuple[BoardDetection, Pose]]]:
    """Return what a calibration knows of its camera, and the views that count with camera_T_board."""
    require_central(report.calibration.camera.model)
    own, several = report.calibration, sorted({str(view.camera) for view in report.views.detections.views})
    if len(several) > 1:
        names, first = ", ".join(several), several[0]
        raise InvalidInput(f"the views are of several cameras ({names}): name one of a rig file, as rig.yaml#{first}")
    poses = {view.image: view.camera_T_board for view in own.used}
    seen = [
        (view.renumbered(own.board.symmetries()[turn]), pose)
        for view, turn in zip(report.views.detections.views, [each.symmetry for each in own.views], strict=True)
        if (pose := poses.get(view.image)) is not None
    ]
    circle = next(iter(report.file.cameras.values())).image_circle
    boards = CalibrationBoards.of(own)
    if boards is None:
        raise InvalidInput("the lens is held, so that no view changes it")
    distances = boards.nearest, boards.farthest
    return Known(own.camera, own.surface, own.sigma_px, distances, boards.noise_share, circle), seen


def known_of_file(file: CameraFile, where: str, name: str | None, board: Board | None) -> Known:
    """Return what a camera file knows of a camera; board: another one than that of the calibration.

    Raises InvalidInput where it names no board, or states no covariance and noise.
    """
    entry, surface = cameras.select(central_file(file, where), name, where), file.board_shape
    named = file.provenance.get("board")
    if surface is None and isinstance(named, dict) and not any(boards.check(named, "board")):
        surface = Surface.flat(boards.from_block(named))
    same = board is None or (surface is not None and surface.board == board)
    if board is not None and not same:
        surface = Surface.flat(board)
    if surface is None:
        raise InvalidInput("names no board: give --board, such as --board chessboard:9x6:25mm", where=where)
    if entry.camera.covariance is None or not entry.camera.covariance.any() or entry.noise is None:
        raise InvalidInput("states no covariance and noise: calibrate with camcal, or give the detections", where=where)
    known = Known(entry.camera, surface, entry.noise.sigma_px, circle=entry.image_circle)
    if entry.boards is None:
        return known
    distances = (entry.boards.nearest, entry.boards.farthest) if same and surface.board.unit == "m" else None
    return replace(known, distances=distances, noise_share=entry.boards.noise_share)


def pose_words(known: Known, view: SuggestedView) -> str:
    """Return how to hold the board for a view."""
    board = known.surface.board
    if view.tilt:
        side = _SIDES[round(float(np.arctan2(view.lean[1], view.lean[0])) / (np.pi / 4)) % 8]
        what = "corner" if " " in side else "edge"
        axis = {"upper": "the horizontal", "lower": "the horizontal", "left": "the vertical", "right": "the vertical"}
        tilt = f"tilted {np.degrees(view.tilt):.0f}° about {axis.get(side, 'a diagonal')}, {side} {what} nearer"
    else:
        tilt = "facing the camera"
    if max(board.extent) > _SQUARE * min(board.extent):
        upright = view.upright == (board.extent[0] > board.extent[1])
        tilt += ", long side upright" if upright else ", long side across"
    unit = " m" if board.unit == "m" else " squares"
    return f"{tilt}; in the {_place(known, view)} of the image; at {view.distance:.2g}{unit}"


def _place(known: Known, view: SuggestedView) -> str:
    """Return where in the image the middle of a board is, in words."""
    column, row = (
        int(np.clip(3 * (at + 0.5) / side, 0, 2)) for at, side in zip(view.centre, known.camera.image_size, strict=True)
    )
    words = [("upper", "", "lower")[row], ("left", "", "right")[column]]
    return f"{' '.join(filter(None, words))} part" if any(words) else "middle"


def rows(report: AdviseReport) -> Iterator[list[str]]:
    """Yield the rows of the table: the suggested views."""
    for number, view in enumerate(report.found.views, start=1):
        yield [str(number), pose_words(report.known, view), f"{view.std_px:.3g}"]


def lines(report: AdviseReport) -> Iterator[str]:
    """Yield what is said beside the table."""
    advice = report.found
    if advice.spared:
        listed, share = ", ".join(map(_name, advice.spared)), 100 * advice.spared_share
        yield f"{counted(len(advice.spared), 'view')} may be left out ({share:.1f} % more uncertainty): {listed}"
    if report.known.distances is None:
        yield "distances: at which the board takes 40 to 85 % of the image, as those of the calibration are not known"


def _name(image: str) -> str:
    return Path(image).name


def headline(report: AdviseReport) -> str:
    """Return the uncertainty as it is, in words."""
    now, views = report.found.std_px, report.found.views
    after = views[-1].std_px
    return f"Projection uncertainty over the image (1 sigma, RMS): {now:.3g} px, after these views {after:.3g} px"


def document(report: AdviseReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    board = report.known.surface.board
    return {
        "uncertainty_px": report.found.std_px,
        "unit": board.unit,
        "views": [_view_data(report.known, view) for view in report.found.views],
        "spared": list(report.found.spared),
        "spared_increase": report.found.spared_share,
        "output": report.output,
    }


def _view_data(known: Known, view: SuggestedView) -> Mapping[str, Any]:
    return {
        "words": pose_words(known, view),
        "tilt_deg": float(np.degrees(view.tilt)),
        "nearer_side": list(view.lean),
        "turned_deg": 90.0 if view.upright else 0.0,
        "centre_px": list(view.centre),
        "distance": view.distance,
        "camera_T_board": {"t": view.pose.translation, "rotation_vector": view.pose.vector()},
        "uncertainty_px": view.std_px,
    }
