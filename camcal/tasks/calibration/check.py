"""`camcal check`: whether a calibration still holds, by new images."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import inf
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from camcal import files
from camcal.arrays import FloatArray
from camcal.calibrate.known_cameras import KnownBoard
from camcal.dataclass import dataclass, replace
from camcal.errors import GateFailed, InsufficientData, InvalidInput
from camcal.formats import cameras, split_address
from camcal.formats.boards import short_form
from camcal.formats.camera_file import CameraEntry, CameraFile, pair_covariance, parameters_covariance, pose_between
from camcal.formats.poses.record import Poses
from camcal.formats.provenance import image_counts
from camcal.geometry.pose import JOINT, Pose
from camcal.messages import Message
from camcal.progress import SILENT, Progress, stage, warn_of
from camcal.quality.camera_check import (
    DRIFTED,
    NOT_SHOWN,
    VALID,
    WORDS,
    Checked,
    CheckedCamera,
    check_lens,
    check_mount,
    check_place,
    usable,
)
from camcal.quality.camera_drift import LensDrift, PlaceDrift
from camcal.quality.view_advice import Known
from camcal.report.table import Column
from camcal.run.outputs import claim, writes
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.advise import pose_words
from camcal.tasks.calibration.board_views import board_views, view_settings
from camcal.tasks.calibration.check_options import CheckOptions
from camcal.tasks.given_camera import read_part, require_no_image
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.rigs.rig_views import rig_views

COLUMNS = (
    Column("camera", file=True),
    Column("drift", "px"),
    Column("± std", "px"),
    Column("limit", "px"),
    Column("verdict", wraps=True),
)


@dataclass(frozen=True, eq=False)
class CheckReport:
    """What was found of cameras, and of where those of a rig stand to each other, by names such as right_T_left."""

    found: Mapping[str, Checked]
    warnings: tuple[Message, ...] = ()
    outputs: tuple[Path, ...] = ()

    @property
    def verdict(self) -> str:
        """The verdict on all of them: the worst one."""
        return min((each.verdict for each in self.found.values()), key=list(WORDS).index)

    def require_valid(self) -> None:
        """Raise GateFailed where something has drifted, InsufficientData where the images could not show it."""
        found = {
            verdict: {name: each for name, each in self.found.items() if each.verdict == verdict} for verdict in WORDS
        }
        drifted = [Message("drifted", each.words, _figures(each), name) for name, each in found[DRIFTED].items()]
        if drifted:
            raise GateFailed(f"{WORDS[DRIFTED]}: {', '.join(found[DRIFTED])}", failures=drifted)
        hidden = [Message("not_shown", each.words, _figures(each), name) for name, each in found[NOT_SHOWN].items()]
        if hidden:
            raise InsufficientData(f"{WORDS[NOT_SHOWN]}: {', '.join(found[NOT_SHOWN])}", failures=hidden)


@writes
def check(options: CheckOptions, progress: Progress = SILENT) -> CheckReport:
    """Return what new images say of a calibration, after drawing and writing it where that is asked for.

    Raises InvalidInput or FileError for a camera file without a covariance, images that cannot be read, and boards that
    are not known, InsufficientData where no image shows the board.
    """
    path, name = split_address(options.camera)
    require_no_image(path)
    file = read_part(path, options.part, progress)
    entries = dict(file.cameras) if name is None else {name: cameras.select(file, name, str(path))}
    board = options.board
    if board is None and file.board_shape is not None:
        board = file.board_shape.board
    outputs = tuple(each for each in (options.junit, options.plot, options.report) if each is not None)
    claim(outputs)
    if options.plot is not None and (len(entries) > 1 or options.reference is not None):
        raise InvalidInput("--plot draws the drift of one lens: name one, as FILE#NAME, or give --report")
    if options.reference is not None:
        report = CheckReport(_check_mounts(options, options.reference, board, progress), outputs=outputs)
        _write(report, options, {})
        return report
    known = {each: _known_camera(each, entry, file, str(path)) for each, entry in entries.items()}
    if options.tags is not None:
        raise InvalidInput("--tags goes with --reference: a lens is checked by a board")
    seen = _look(options, board, tuple(entries), progress)
    surface = file.board_shape if file.board_shape is not None and file.board_shape.board == seen.board else None
    views = min(known[name].views for name in seen.views)
    shape = KnownBoard(Surface.flat(seen.board)) if surface is None else KnownBoard(surface, views)
    found: dict[str, Checked] = {}
    with stage(progress, "checking"):
        for each, own in seen.views.items():
            found[each] = _with_advice(check_lens(known[each], own, shape, options.most_px), known[each], shape)
        found |= _check_places(seen.rows, file, known, shape, found, options.most_px)
    report = CheckReport(found, seen.warnings, outputs)
    warn_of([Message("check_image", note, {}, each) for each, own in found.items() for note in own.notes], progress)
    _write(report, options, known)
    return report


@dataclass(frozen=True, eq=False)
class CheckViews:
    """The views of every camera that is checked, by its name; of several the usable ones of every capture as well."""

    board: Board
    views: Mapping[str, Sequence[BoardDetection]]
    rows: Sequence[Mapping[str, BoardDetection]] = ()
    warnings: tuple[Message, ...] = ()


def _look(options: CheckOptions, board: Board | str | None, names: tuple[str, ...], progress: Progress) -> CheckViews:
    """Return what the inputs show of the board."""
    if len(names) == 1:
        one = board_views(options.inputs, board, progress=progress, **view_settings(options))
        return CheckViews(one.board, {names[0]: one.detections.views}, warnings=one.warnings)
    settings = RigSettings(
        board=board,
        match=options.match,
        recursive=options.recursive,
        jobs=options.jobs,
        image_size=options.image_size,
        reading=options.reading,
        frames=options.frames,
        refine=False,
    )
    rig = rig_views(options.inputs, settings, progress)
    cameras = rig.captures.cameras
    if unknown := [each for each in cameras if each not in names]:
        raise InvalidInput(f"no camera {unknown[0]!r}; it has {', '.join(names)}", where=options.camera)
    rows = [
        {name: view for name, view in zip(cameras, row, strict=True) if view is not None and usable([view])}
        for row in rig.captures.views
    ]
    return CheckViews(rig.board, {name: rig.of(name) for name in cameras}, rows, rig.warnings)


def check_camera(
    camera: Path | str, images: Sequence[Path | str], board: Board | str | None = None, max_drift: float | None = None
) -> CheckReport:
    """Return whether the calibration of a camera still holds, by new images of a board.

    camera: a camera file with a covariance, FILE or FILE#NAME. images: images, videos, folders or one detections file.
    board: None for the one of the calibration. max_drift: px RMS, the drift that counts; None for the larger of 0.5 px
    and three standard deviations of the calibration. Raises what `check` raises.
    """
    return check(CheckOptions(str(camera), tuple(map(str, images)), board, max_drift))


def _known_camera(name: str, entry: CameraEntry, file: CameraFile, where: str) -> CheckedCamera:
    """Return what a file says of one of its cameras; its covariance may be a part of that of the rig."""
    known = parameters_covariance(file)
    rows = [known.names.index(f"{name}.{each}") for each in entry.camera.model.parameter_names]
    covariance = known.matrix[np.ix_(rows, rows)]
    if not covariance.any():
        raise InvalidInput(
            "states no covariance, so that nothing tells what a drift is: calibrate with camcal, or compare a new "
            "calibration with this one, see 'camcal diff'",
            where=where if len(file.cameras) == 1 else f"{where}#{name}",
        )
    region = entry.verdict.region if entry.verdict is not None else None
    return CheckedCamera(
        replace(entry.camera, covariance=covariance),
        0.0 if entry.noise is None else entry.noise.sigma_px,
        np.zeros((0, 2)) if region is None else region.polygon,
        float(entry.quality.get("images_used") or image_counts(file.provenance)[0] or inf),
    )


def _with_advice(checked: Checked, own: CheckedCamera, board: KnownBoard) -> Checked:
    """Return a result whose reason says which image would show most."""
    if checked.next_view is None:
        return checked
    words = pose_words(Known(own.camera, board.surface, own.sigma_px), checked.next_view)
    return replace(checked, reason=f"{checked.reason}; most would show one with the board {words}")


def _check_places(
    rows: Sequence[Mapping[str, BoardDetection]],
    file: CameraFile,
    cameras: Mapping[str, CheckedCamera],
    board: KnownBoard,
    found: Mapping[str, Checked],
    most_px: float | None,
) -> Iterator[tuple[str, Checked]]:
    """Yield what captures say of where every camera stands to one before it, that which it has most captures with.

    Those of lenses that have drifted cannot be told from that.
    """
    names = [name for name in found if found[name].verdict != DRIFTED]
    for place, name in enumerate(names[1:], start=1):
        others = {each: [row for row in rows if name in row and each in row] for each in names[:place]}
        partner = max(others, key=lambda each: len(others[each]))
        pose = pose_between(file, name, partner)
        both = [(row[partner], row[name]) for row in others[partner]]
        if not both or pose is None:
            continue
        covariance = pair_covariance(file, partner, name)
        pair = cameras[partner], cameras[name]
        yield f"{name}{JOINT}{partner}", check_place(pair, both, pose, covariance, board, most_px)


def _check_mounts(
    options: CheckOptions, reference: Path, board: Board | str | None, progress: Progress
) -> dict[str, Checked]:
    """Return what the pose of a board, or of every tag, says of where the camera stands."""
    from camcal.formats import poses
    from camcal.tasks.poses.options import DetectionOptions, PnpOptions
    from camcal.tasks.poses.pnp import pnp

    before = poses.read(reference)
    shown = short_form(board) if isinstance(board, Board) else board
    detection = DetectionOptions(
        shown if options.tags is None else None, options.tags, recursive=options.recursive, jobs=options.jobs
    )
    now = pnp(PnpOptions(options.camera, inputs=options.inputs, detection=detection), progress).poses
    if {before.unit, now.unit} != {"m"}:
        raise InvalidInput(
            "its poses are not in metres: give the size of the board or of the tags", where=str(reference)
        )
    known, found = (_by_object(each if each.of_object else each.inverse()) for each in (before, now))
    missing = [name or "the board" for name in known if name not in found]
    if missing == list(known):
        raise InsufficientData(f"no image shows what {reference} has the pose of: {', '.join(missing)}")
    return {
        name or "mount": check_mount(known[name], own, options.most_shift, options.most_turn)
        for name, own in found.items()
        if name in known
    }


def _by_object(found: Poses) -> dict[str, list[tuple[Pose, FloatArray]]]:
    """Return the poses of every object, and what noise leaves open of them: the lens is the same before and after."""
    result: dict[str, list[tuple[Pose, FloatArray]]] = {}
    for key, record in found.estimates.items():
        result.setdefault(key.object, []).append((record.transform, record.noise_covariance))
    return result


def _write(report: CheckReport, options: CheckOptions, known: Mapping[str, CheckedCamera]) -> None:
    if options.junit is not None:
        files.write_text(options.junit, junit(report, options.camera))
    if options.report is not None:
        from camcal.report.page.checks import check_page
        from camcal.report.page.record import rendered
        from camcal.tasks.reports.closing import made

        page = check_page(report.found, known, options.camera, report.verdict, made())
        files.write_text(options.report, rendered(page))
    drift = next(iter(report.found.values())).drift
    if options.plot is not None and isinstance(drift, LensDrift):
        from camcal.report.figures.differences import lens_drift
        from camcal.report.figures.figure import encoded

        files.write_bytes(options.plot, encoded(lens_drift(drift), options.plot.suffix))


def rows(report: CheckReport) -> list[list[object]]:
    """Return the rows of the table."""
    table: list[list[object]] = []
    for name, each in report.found.items():
        figures = ["", ""] if each.drift is None else [f"{each.drift.rms_px.value:.3g}", f"{each.drift.rms_px.std:.2g}"]
        limit = "" if each.limit_px is None else f"{each.limit_px:.3g}"
        table.append([name, *figures, limit, each.words])
    return table


def document(report: CheckReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "verdict": report.verdict,
        "checks": {name: {"verdict": each.verdict, **_figures(each)} for name, each in report.found.items()},
        "outputs": list(report.outputs),
    }


def _figures(checked: Checked) -> dict[str, Any]:
    """Return the figures of a check as plain data."""
    drift, movement = checked.drift, checked.movement
    found: dict[str, Any] = {"cause": checked.cause, "reason": checked.reason, "views": checked.views}
    found |= {"notes": list(checked.notes), "limit_px": checked.limit_px}
    if movement is not None:
        found |= {"shift_m": vars(movement.shift), "turn_rad": vars(movement.turn), "chance": movement.chance}
        return found | {"step": movement.step.tolist(), "covariance": movement.covariance.tolist()}
    if drift is None:
        return found
    found |= {"drift_px": vars(drift.rms_px), "worst_px": vars(drift.worst_px), "chance": drift.chance}
    found |= {"smallest_px": drift.smallest_px, "calibration_px": drift.calibration_px}
    if isinstance(drift, LensDrift):
        found |= {"focal_change": vars(drift.focal), "principal_point_shift_px": [vars(each) for each in drift.shift]}
        return found | {"distortion_px": drift.distortion_px}
    assert isinstance(drift, PlaceDrift)
    parts = {
        "shift_m": drift.shift,
        "shift_std_m": drift.shift_std,
        "turn_rad": drift.turn,
        "turn_std_rad": drift.turn_std,
    }
    return found | {name: values.tolist() for name, values in parts.items()}


def junit(report: CheckReport, camera: str) -> str:
    """Return the report as JUnit XML: a test case for each check; what could not be shown counts as skipped."""
    cases = []
    for name, each in report.found.items():
        head = f"  <testcase classname={quoteattr(camera)} name={quoteattr(name)}"
        if each.verdict == VALID:
            cases.append(f"{head}><system-out>{escape(each.words)}</system-out></testcase>")
            continue
        element = "failure" if each.verdict == DRIFTED else "skipped"
        kind = f" type={quoteattr(each.cause)}" if each.verdict == DRIFTED else ""
        cases.append(f"{head}><{element} message={quoteattr(each.words)}{kind}/></testcase>")
    counts = Counter(each.verdict for each in report.found.values())
    start = (
        f'<testsuite name="camcal check" tests="{len(report.found)}" failures="{counts[DRIFTED]}" '
        f'skipped="{counts[NOT_SHOWN]}" errors="0">'
    )
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', start, *cases, "</testsuite>", ""])
