"""`camcal calibrate`: images or a detections file in, one camera file out."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import floor, log10, radians
from pathlib import Path
from typing import Any

from camcal import files
from camcal.calibrate import intrinsics
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration, View
from camcal.cameras.catalogue import model_named
from camcal.cameras.validity import valid_block
from camcal.errors import CamcalError, InsufficientData, InvalidInput, NotConverged
from camcal.formats import boards, detections, native, provenance
from camcal.formats.camera_file import CameraEntry, CameraFile, Noise, ValidRegion, Verdict
from camcal.progress import SILENT, Progress
from camcal.quality.advise import Advice, advise, misfits
from camcal.run.inputs import split_address
from camcal.targets.board import Board, Detections
from camcal.targets.surface import TIERS
from camcal.tasks.detect import DetectOptions, detect_images

DEFAULT_MODEL = "opencv5"
WIDE_MODELS = ("kannala_brandt4", "opencv8")
BETTER = 0.7  # another model must lower the noise to this share to be taken unasked
DETECTION_SUFFIXES = (".csv", ".vnl")


@dataclass(frozen=True)
class CalibrateOptions:
    """What to calibrate from and how; see `camcal calibrate --help`.

    inputs: images, folders and globs, or one detections file. model: None for DEFAULT_MODEL, or where that cannot
    hold the lens, the best of WIDE_MODELS. board: a board file or short form, None when the
    detections file names it. max_rejected: share of the corners, 0 to 1.
    """

    inputs: tuple[str, ...]
    output: Path
    board: str | None = None
    model: str | None = None
    fix: tuple[str, ...] = ()
    guess: str | None = None
    flat_board: bool = False
    free_corners: bool = True
    max_rejected: float = 0.1
    name: str = "camera"
    save_detections: Path | None = None
    recursive: bool = False
    jobs: int | None = None


@dataclass(frozen=True)
class Parameter:
    """A lens parameter as text: its standard deviation to two digits, its value to the same place."""

    name: str
    value: str
    std: str

    @classmethod
    def of(cls, name: str, value: float, std: float | None) -> "Parameter":
        """Return the text of a value and its standard deviation; None says that it was held."""
        if not std:
            return cls(name, f"{value:.6g}", "fixed" if std is None else "0")
        digits = max(0, 1 - floor(log10(std)))
        return cls(name, f"{value:.{digits}f}", f"{std:.{digits}f}")


@dataclass(frozen=True, eq=False)
class CalibrateReport:
    """The calibration, what is to be said of it, the file that was written, remarks of the detection, failed inputs."""

    calibration: Calibration
    advice: Advice
    file: CameraFile
    notes: tuple[str, ...]
    failed: tuple[str, ...]

    def parameters(self) -> list[Parameter]:
        """Return the lens parameters for showing: text of value and standard deviation to its two leading digits."""
        camera = self.calibration.camera
        return [Parameter.of(name, camera.value(name), camera.std(name)) for name in camera.model.parameter_names]

    def summary(self) -> list[str]:
        """Return what the numbers say of residuals and board, a line each."""
        calibration = self.calibration
        unused = len(calibration.views) - len(calibration.used)
        lines = [
            f"RMS {calibration.rms_px:.3f} px over {len(calibration.residuals)} corners of "
            f"{len(calibration.used)} views ({unused} not used, {len(calibration.rejected)} corners rejected); "
            f"noise {calibration.sigma_px:.3f} px"
        ]
        return lines + _board_lines(calibration)


def _board_lines(calibration: Calibration) -> list[str]:
    surface = calibration.surface
    factor, unit = (1e3, "mm") if calibration.board.unit == "m" else (1.0, "squares")
    lines = []
    if surface.deflection:
        bend, std = factor * surface.deflection, factor * surface.deflection_std
        lines.append(f"board: bent by {bend:.3f} ± {std:.3f} {unit} peak to peak ({', '.join(surface.tiers)})")
    spread = surface.coefficients_std()
    for term, value, std in zip(surface.terms, surface.coefficients, spread, strict=True):
        if term in TIERS["stretch"]:
            also = ", ".join(
                f"{pair[1]} {correlation:+.2f}"
                for pair, correlation in calibration.correlations.items()
                if pair[0] == term
            )
            lines.append(f"board: {term} {100 * value:+.3f} ± {100 * std:.3f} % (correlation with {also or 'nothing'})")
    if surface.offsets is not None:
        lines.append(f"board: every corner free, by up to {factor * float(abs(surface.offsets).max()):.3f} {unit}")
    if not lines:
        lines.append("board: flat and true to the drawing as far as the data can tell")
    return lines


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
    calibration, remarks = _solve(found, found.board, how, options.model is None)
    progress.finish()
    advice = advise(calibration)
    file = camera_file(calibration, advice, options)
    native.write(options.output, file)
    return CalibrateReport(calibration, advice, file, notes + remarks, failed)


def _solve(
    found: Detections, board: Board, how: intrinsics.Options, choose: bool
) -> tuple[Calibration, tuple[str, ...]]:
    """Return the calibration and remarks; `choose`: take a wide lens model where the default one does not fit."""
    failure: CamcalError | None = None
    first: Calibration | None = None
    try:
        first = intrinsics.calibrate(found.views, board, how)
    except (InsufficientData, NotConverged) as error:
        failure = error
    if not choose or (first is not None and not misfits(first)):
        return _or_raise(first, failure), ()
    others = [_attempt(found, board, replace(how, model=model_named(name))) for name in WIDE_MODELS]
    best = min((other for other in others if other), key=lambda other: other.sigma_px, default=None)
    if best is None or (first is not None and best.sigma_px > BETTER * first.sigma_px):
        return _or_raise(first, failure), ()
    left = f"leaves {first.sigma_px:.2f} px of noise" if first else "finds no solution"
    name = best.camera.model.name
    return best, (f"{DEFAULT_MODEL} {left}, {name} {best.sigma_px:.2f} px: {name} is used (--model decides otherwise)",)


def _attempt(found: Detections, board: Board, how: intrinsics.Options) -> Calibration | None:
    try:
        return intrinsics.calibrate(found.views, board, how)
    except (InvalidInput, InsufficientData, NotConverged):
        return None


def _or_raise(calibration: Calibration | None, failure: CamcalError | None) -> Calibration:
    if calibration is None:
        raise failure or NotConverged("no solution was found")
    return calibration


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
        model_named(options.model or DEFAULT_MODEL),
        options.fix,
        guess,
        ShapeOptions(smooth=not options.flat_board, offsets=options.free_corners),
        options.max_rejected,
    )


def _observations(options: CalibrateOptions, progress: Progress) -> tuple[Detections, tuple[str, ...], tuple[str, ...]]:
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
    valid = valid_block(calibration.camera)
    entry = CameraEntry(
        calibration.camera,
        valid=ValidRegion(radians(valid["max_theta_deg"]), valid["max_radius_px"]),
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
    arguments += ["--model", options.model] if options.model else []
    arguments += [*(["--fix", ",".join(options.fix)] if options.fix else [])]
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


def document(report: CalibrateReport, output: Path) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    calibration, camera = report.calibration, report.calibration.camera
    surface = calibration.surface
    return {
        "output": output.as_posix(),
        "model": camera.model.name,
        "image_size": list(camera.image_size),
        "parameters": {name: camera.value(name) for name in camera.model.parameter_names},
        "std": {name: camera.std(name) for name in camera.model.parameter_names},
        "rms_px": calibration.rms_px,
        "sigma_px": calibration.sigma_px,
        "board": boards.block(calibration.board),
        "board_shape": {
            "unit": calibration.board.unit,
            "tiers": list(surface.tiers),
            "terms": dict(zip(surface.terms, surface.coefficients.tolist(), strict=True)),
            "deflection": surface.deflection,
            "deflection_std": surface.deflection_std,
            "free_corners": surface.offsets is not None,
            "correlations": {f"{a}, {b}": value for (a, b), value in calibration.correlations.items()},
        },
        "views": [_image(view) | {"turned": view.turned} for view in calibration.views],
        "rejected": [
            {
                "image": corner.image,
                "id": corner.id,
                "pixel": corner.pixel.tolist(),
                "residual": corner.residual.tolist(),
            }
            for corner in calibration.rejected
        ],
        "failed": list(report.failed),
        "notes": list(report.notes),
        "remarks": list(report.advice.remarks),
        "trustworthy": report.advice.trustworthy,
        "reasons": list(report.advice.reasons),
    }
