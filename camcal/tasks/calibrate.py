"""`camcal calibrate`: images or a detections file in, one camera file out."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camcal import files
from camcal.calibrate import intrinsics
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration, View
from camcal.cameras.catalogue import model_named
from camcal.cameras.validity import valid_region
from camcal.errors import InvalidInput
from camcal.formats import boards, detections, native, provenance
from camcal.formats.camera_file import CameraEntry, CameraFile, Noise, Verdict
from camcal.progress import SILENT, Progress
from camcal.quality.advise import Advice, advise
from camcal.run.inputs import split_address
from camcal.targets.board import Detections
from camcal.tasks.detect import DetectOptions, detect_images

DETECTION_SUFFIXES = (".csv", ".vnl")


@dataclass(frozen=True)
class CalibrateOptions:
    """What to calibrate from and how; see `camcal calibrate --help`.

    inputs: images, folders and globs, or one detections file. board: a board file or short form, None when the
    detections file names it. max_rejected: share of the corners, 0 to 1.
    """

    inputs: tuple[str, ...]
    output: Path
    board: str | None = None
    model: str = "opencv5"
    fix: tuple[str, ...] = ()
    guess: str | None = None
    flat_board: bool = False
    free_corners: bool = True
    max_rejected: float = 0.1
    name: str = "camera"
    save_detections: Path | None = None
    recursive: bool = False
    jobs: int | None = None


@dataclass(frozen=True, eq=False)
class CalibrateReport:
    """The calibration, what is to be said of it, the file that was written, remarks of the detection, failed inputs."""

    calibration: Calibration
    advice: Advice
    file: CameraFile
    notes: tuple[str, ...]
    failed: tuple[str, ...]


def calibrate(options: CalibrateOptions, progress: Progress = SILENT) -> CalibrateReport:
    """Return the calibration of one camera after writing it to options.output.

    Raises InvalidInput, FileError, InsufficientData or NotConverged; nothing is written then.
    """
    _refuse_overwriting(options)
    how = _solver_options(options)
    found, notes, failed = _observations(options, progress)
    if found.board is None:
        raise InvalidInput("no board is known: give --board, such as --board chessboard:9x6:25mm")
    if options.save_detections:
        detections.write(options.save_detections, found)
    progress.start("solving", None)
    calibration = intrinsics.calibrate(found.views, found.board, how)
    progress.finish()
    advice = advise(calibration)
    file = camera_file(calibration, advice, options)
    native.write(options.output, file)
    return CalibrateReport(calibration, advice, file, notes, failed)


def _refuse_overwriting(options: CalibrateOptions) -> None:
    outputs = [path for path in (options.output, options.save_detections) if path is not None]
    for path in outputs:
        if any(Path(text).resolve() == path.resolve() for text in options.inputs):
            raise InvalidInput("is an input and is not overwritten; choose another output", where=str(path))


def _solver_options(options: CalibrateOptions) -> intrinsics.Options:
    guess = None
    if options.guess is not None:
        path, name = split_address(options.guess)
        guess = native.read_camera(path, name)
    if not 0 <= options.max_rejected <= 1:
        raise InvalidInput(f"--max-rejected {options.max_rejected:g} is not a share between 0 and 1")
    return intrinsics.Options(
        model_named(options.model),
        options.fix,
        guess,
        ShapeOptions(smooth=not options.flat_board, offsets=options.free_corners),
        options.max_rejected,
    )


def _observations(
    options: CalibrateOptions, progress: Progress
) -> tuple[Detections, tuple[str, ...], tuple[str, ...]]:
    """Return the detections, remarks on them, and the inputs that failed."""
    board = boards.load_board(options.board) if options.board else None
    if _names_detections(options.inputs):
        return detections.read(Path(options.inputs[0]), board), (), ()
    if board is None:
        raise InvalidInput("--board is needed to find one in images, such as --board chessboard:9x6:25mm")
    report = detect_images(
        DetectOptions(options.inputs, board, recursive=options.recursive, jobs=options.jobs), progress
    )
    return report.detections, report.notes, report.failed


def _names_detections(inputs: tuple[str, ...]) -> bool:
    tables = [text for text in inputs if Path(text).suffix.lower() in DETECTION_SUFFIXES]
    if tables and len(inputs) > 1:
        raise InvalidInput(f"{tables[0]}: a detections file is calibrated from alone, without images or other files")
    return bool(tables)


def camera_file(calibration: Calibration, advice: Advice, options: CalibrateOptions) -> CameraFile:
    """Return what the camera file says of a calibration."""
    entry = CameraEntry(
        calibration.camera,
        valid=valid_region(calibration.camera),
        quality=quality_figures(calibration),
        noise=Noise(calibration.sigma_px, calibration.freedom),
        verdict=Verdict(advice.trustworthy, advice.reasons),
    )
    shaped = calibration.surface.tiers or calibration.surface.offsets is not None
    return CameraFile(
        {options.name: entry},
        board_shape=calibration.surface if shaped else None,
        provenance=_provenance(calibration, options),
    )


def quality_figures(calibration: Calibration) -> dict[str, float]:
    """Return the figures of the file's quality block: pixels and counts."""
    import numpy as np

    lengths = np.linalg.norm(calibration.residuals, axis=1)
    return {
        "rms_px": calibration.rms_px,
        "median_px": float(np.median(lengths)),
        "p95_px": float(np.percentile(lengths, 95)),
        "max_px": float(lengths.max()),
        "images_used": len(calibration.used),
        "points_used": len(lengths),
        "points_rejected": len(calibration.rejected),
    }


def _provenance(calibration: Calibration, options: CalibrateOptions) -> Mapping[str, Any]:
    arguments = ["calibrate", *options.inputs, *(["--board", options.board] if options.board else [])]
    arguments += ["--model", options.model, *(["--fix", ",".join(options.fix)] if options.fix else [])]
    arguments += ["--guess", options.guess] if options.guess else []
    arguments += ["--flat-board"] if options.flat_board else []
    return provenance.build(arguments, calibration.board, [_image(view) for view in calibration.views])


def _image(view: View) -> dict[str, Any]:
    path = Path(view.image)
    result: dict[str, Any] = {"file": view.image}
    if path.is_file():
        result["sha256"] = files.sha256(path)
    result |= {"used": view.used, "points": view.points}
    if view.rms_px is not None:
        result["rms_px"] = view.rms_px
    return result | ({"reason": view.reason} if view.reason else {})
