"""A calibration, and when cameras took their images, as text and as plain data."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import degrees
from typing import TYPE_CHECKING, Any

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration, CandidateModel, View
from camcal.formats import boards
from camcal.messages import counted
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.report.table import Column, held_by_prior_words, length_unit, value_and_std
from camcal.targets.board import RATIOS

if TYPE_CHECKING:
    from camcal.calibrate.timing.record import CameraTime, CameraTimes

CANDIDATE_COLUMNS = (
    Column("lens model"),
    Column("log likelihood per corner"),
    Column("prediction error", "px"),
    Column("uncertainty over the image", "px"),
    Column("reason", wraps=True),
)
_LEAST_OFFSET = 1e-5  # of the board's longer side: corners that are off by less are where they were drawn
_SHOWN = 2.0  # standard deviations: less of a board's shape is not worth a line


def parameter_rows(calibration: Calibration) -> list[tuple[str, str, str]]:
    """Return name, value and standard deviation of the lens parameters as text."""
    camera = calibration.camera
    rows = [(name, *value_and_std(camera.value(name), camera.std(name))) for name in camera.listed]
    return [(name, value, "fixed" if name in camera.fixed else std) for name, value, std in rows]


def headline(calibration: Calibration) -> str:
    """Return lens model and focal lengths with their standard deviations, in a line."""
    camera = calibration.camera
    focal = ", ".join(
        f"{name} {' ± '.join(value_and_std(camera.value(name), camera.std(name)))}" for name in ("fx", "fy")
    )
    unit = "px" if camera.model.is_central else "px/m"
    return f"Lens model {camera.model.name}, {focal} {unit}"


def candidate_rows(candidates: Sequence[CandidateModel]) -> list[list[str]]:
    """Return name, score below the best, prediction error, uncertainty and what went wrong of lens models, the best
    first.
    """
    best = max(own.score for own in candidates)
    return [
        [
            own.name,
            f"{own.score - best:.3f}" if own.scores is not None else "",
            f"{own.sigma_px:.3f}" if own.sigma_px is not None else "",
            f"{own.map_px:.2g}" if own.map_px is not None else "",
            own.reason or ", ".join(own.failures),
        ]
        for own in sorted(candidates, key=lambda own: -own.score)
    ]


def candidates_data(candidates: Sequence[CandidateModel]) -> list[dict[str, Any]]:
    """Return the lens models that were compared as plain data."""
    return [
        {
            "model": own.name,
            "nat_per_corner": own.score if own.scores is not None else None,
            "prediction_error_px": own.sigma_px,
            "uncertainty_px": own.map_px,
            "failures": list(own.failures),
            "reason": own.reason,
        }
        for own in candidates
    ]


def summary(calibration: Calibration) -> list[str]:
    """Return lines about the residuals and the board."""
    unused, rejected = len(calibration.views) - len(calibration.used), len(calibration.rejected)
    left_out = [f"{unused} not used"] * (unused > 0) + [f"{counted(rejected, 'corner')} rejected"] * (rejected > 0)
    residuals = (
        f"RMS {calibration.rms_px:.3f} px over {counted(len(calibration.residuals), 'corner')} of "
        f"{counted(len(calibration.used), 'view')}"
        + (f" ({', '.join(left_out)})" if left_out else "")
        + f"; noise {calibration.sigma_px:.3f} px"
    )
    held = [held_by_prior_words(calibration.held_by_prior)] if calibration.held_by_prior else []
    return [
        residuals,
        *held,
        *_noise_lines(calibration),
        *_within_views_lines(calibration),
        *_pupil_lines(calibration),
        *_board_lines(calibration),
    ]


def _noise_lines(calibration: Calibration) -> list[str]:
    """Return what the noise is made of, where the images say how well they show the corners."""
    model_error = calibration.model_error_px
    if model_error is None:
        return []
    images = max(calibration.sigma_px**2 - model_error**2, 0.0) ** 0.5
    parts = f"{images:.3f} corner detection, {model_error:.3f} board and lens model"
    return [f"Noise {calibration.sigma_px:.3f} px: {parts}"]


def _within_views_lines(calibration: Calibration) -> list[str]:
    """Return what is wrong with single views beside noise, where it is clear that there is anything."""
    errors, lines = calibration.within_views, []
    if errors.rolling_px is not None:
        typical, most = errors.rolling_px
        lines.append(f"Rolling shutter: {typical:.2g} px over the height of a typical image, at most {most:.2g} px")
    if errors.flex is not None:
        factor, unit = length_unit(calibration.board)
        typical, most = (factor * value for value in errors.flex)
        lines.append(f"The board bends: by {typical:.2g} {unit} RMS in a typical view, at most {most:.2g} {unit}")
    if errors.share > 0 and not lines:
        lines.append("Errors within views of unknown cause: included in the standard deviations")
    return lines


def _pupil_lines(calibration: Calibration) -> list[str]:
    """Return how far the lens is from having one centre, where that is clear."""
    pupil = calibration.between_views.pupil
    if pupil is None or not pupil.seen:
        return []
    factor, unit = length_unit(calibration.board)
    shift, std = value_and_std(factor * pupil.shift, factor * pupil.std)
    moved = f"Entrance pupil moves by {shift} ± {std} {unit} to {degrees(pupil.angle):.0f}°"
    return [f"{moved}: there boards and things far away in one direction are {pupil.moved_px:.2g} px apart"]


def _board_lines(calibration: Calibration) -> list[str]:
    surface = calibration.surface
    factor, unit = length_unit(calibration.board)
    lines = []
    if surface.deflection > _SHOWN * surface.deflection_std:
        bend, std = value_and_std(factor * surface.deflection, factor * surface.deflection_std)
        lines.append(f"board: bent by {bend} ± {std} {unit} peak to peak")
    for term, value, std in zip(surface.terms, surface.coefficients, surface.coefficients_std(), strict=True):
        if term in RATIOS and abs(value) > _SHOWN * std:
            shown = " ± ".join(value_and_std(100 * value, 100 * std))
            pairs = calibration.correlations.items()
            with_focal = ", ".join(f"{pair[1]} {share:+.2f}" for pair, share in pairs if pair[0] == term)
            lines.append(f"board: {term} {shown} %" + (f" (correlation with {with_focal})" if with_focal else ""))
    largest = 0.0 if surface.offsets is None else float(abs(surface.offsets).max())
    if largest > _LEAST_OFFSET * max(calibration.board.extent):
        lines.append(f"Per-corner board offsets estimated; largest {factor * largest:.2g} {unit}")
    return lines


def view_record(view: View) -> dict[str, Any]:
    """Return what became of one image as plain data."""
    record: dict[str, Any] = {"file": view.image, "used": view.used, "points": view.points}
    if view.rms_px is not None:
        record["rms_px"] = view.rms_px
    return record | ({"reason": view.reason} if view.reason else {})


def as_data(calibration: Calibration) -> dict[str, Any]:
    """Return everything of a calibration that a program may want, as plain data; lengths in `board_shape.unit`."""
    camera, surface = calibration.camera, calibration.surface
    noise = replace(camera, covariance=calibration.noise_covariance)  # if noise were all that is wrong with the corners
    return {
        "model": camera.model.name,
        "image_size": list(camera.image_size),
        "parameters": {name: camera.value(name) for name in camera.model.parameter_names},
        "std": {name: camera.std(name) for name in camera.model.parameter_names},
        "held_by_prior": list(calibration.held_by_prior),
        "noise_std": {name: noise.std(name) for name in noise.model.parameter_names},
        "within_views": _within_views(calibration),
        "entrance_pupil": _pupil(calibration),
        "two_cameras": None if calibration.two_cameras is None else dict(vars(calibration.two_cameras)),
        "rms_px": calibration.rms_px,
        "sigma_px": calibration.sigma_px,
        "model_error_px": calibration.model_error_px,
        "degrees_of_freedom": calibration.degrees_of_freedom,
        "board": boards.block(calibration.board),
        "board_shape": {
            "unit": calibration.board.unit,
            "tiers": list(surface.tiers),
            "classes": {name: {"scale": scale, "std": std} for name, (scale, std) in surface.classes.items()},
            "terms": dict(zip(surface.terms, surface.coefficients.tolist(), strict=True)),
            "std": dict(zip(surface.terms, surface.coefficients_std().tolist(), strict=True)),
            "deflection": surface.deflection,
            "deflection_std": surface.deflection_std,
            "free_corners": surface.offsets is not None,
            "correlations": {f"{term}, {focal}": share for (term, focal), share in calibration.correlations.items()},
        },
        "views": [view_record(view) | {"symmetry": view.symmetry} for view in calibration.views],
        "rejected": [
            {
                "image": corner.image,
                "id": corner.id,
                "pixel": corner.pixel.tolist(),
                "residual": corner.residual.tolist(),
            }
            for corner in calibration.rejected
        ],
    }


def uncertainty_data(uncertainty: ProjectionUncertainty) -> dict[str, Any]:
    """Return the figures of a projection uncertainty and its map, row by row and at four digits, as plain data."""
    shape = (len(uncertainty.v), len(uncertainty.u))
    inside = uncertainty.inside
    return {
        "projection": uncertainty.figures(),
        "map": {
            "u": uncertainty.u.round(3).tolist(),
            "v": uncertainty.v.round(3).tolist(),
            "rms_px": _four_digits(uncertainty.std_rms.reshape(shape)),
            "worst_px": _four_digits(uncertainty.std_worst.reshape(shape)),
            "inside": None if inside is None else inside.reshape(shape).tolist(),
        },
    }


def _pupil(calibration: Calibration) -> dict[str, Any] | None:
    pupil = calibration.between_views.pupil
    if pupil is None:
        return None
    own = {"shift": pupil.shift, "std": pupil.std, "angle_deg": degrees(pupil.angle), "moved_px": pupil.moved_px}
    return {**own, "seen": pupil.seen}


def _within_views(calibration: Calibration) -> dict[str, Any]:
    errors = calibration.within_views
    named = {"rolling_px": errors.rolling_px, "flex": errors.flex}
    return {"share": errors.share} | {
        name: None if sizes is None else {"median": sizes[0], "max": sizes[1]} for name, sizes in named.items()
    }


def _four_digits(values: Array) -> list[list[float]]:
    return [[float(f"{value:.4g}") for value in row] for row in values.tolist()]


def time_lines(times: "CameraTimes | None") -> Iterator[str]:
    """Yield the times of cameras, a line each."""
    if times is None:
        return
    for name, own in times.cameras.items():
        if own.offset_std:
            offset, std = value_and_std(1e3 * own.offset, 1e3 * own.offset_std)
            rate, rate_std = value_and_std(1e6 * own.rate, 1e6 * own.rate_std)
            frames = f"{own.offset / times.interval:+.4f} frames"
            yield f"Time offset of {name}: {offset} ± {std} ms ({frames}), clock rate {rate} ± {rate_std} ppm"
        if own.middle_offset is not None:
            offset, std = value_and_std(1e3 * own.middle_offset, 1e3 * own.middle_offset_std)
            yield f"Time offset of {name} between the middle rows: {offset} ± {std} ms"
        if own.readout is not None:
            readout, std = value_and_std(1e3 * own.readout, 1e3 * own.readout_std)
            yield f"Readout time{f' of {name}' if name else ''}: {readout} ± {std} ms"


def times_data(times: "CameraTimes | None") -> dict[str, dict[str, float]] | None:
    """Return the times of cameras as plain data by their names, as the camera file has them; None without any."""
    return None if times is None else {name: time_data(own) for name, own in times.cameras.items()}


def time_data(own: "CameraTime") -> dict[str, float]:
    """Return the times of a camera by the keys of a camera file."""
    clock = {
        "offset_s": own.offset,
        "offset_std_s": own.offset_std,
        "rate": own.rate,
        "rate_std": own.rate_std,
        "reference_s": own.reference,
    }
    shutter = {} if own.readout is None else {"readout_s": own.readout, "readout_std_s": own.readout_std}
    middle = (
        {}
        if own.middle_offset is None
        else {"middle_offset_s": own.middle_offset, "middle_offset_std_s": own.middle_offset_std}
    )
    return (clock if own.offset_std else {}) | shutter | middle
