"""The figures of `camcal optics` as plain data for --json and as table rows, in practical units."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from math import hypot, isfinite, isnan, pi
from typing import Any, TypeVar

from camcal.optics.lens import FORMATS, literal_mm, smallest_format
from camcal.report.table import number_text
from camcal.targets.board_types import BOARD_TYPES
from camcal.tasks.lenses.board_plan import BoardAt, BoardPlan
from camcal.tasks.lenses.optics import OpticsReport, usable_range
from camcal.tasks.lenses.optics_figures import AtDistance
from camcal.tasks.lenses.optics_setup import Setup

_DEGREES = 180 / pi

At = TypeVar("At", AtDistance, BoardAt)

# figure of a record: its key in the document, words, the factor to its unit, the unit
_Shown = Mapping[str, tuple[str, str, float, str]]
_SETUP: _Shown = {
    "focal": ("focal_mm", "focal length", 1e3, "mm"),
    "focus": ("focus_m", "focus", 1.0, "m"),
    "pitch": ("pixel_pitch_um", "pixel pitch", 1e6, "um"),
    "circle": ("circle_of_confusion_um", "circle of confusion", 1e6, "um"),
}
_FIELD: _Shown = {
    "horizontal": ("horizontal_deg", "field of view, horizontal", _DEGREES, "deg"),
    "vertical": ("vertical_deg", "field of view, vertical", _DEGREES, "deg"),
    "diagonal": ("diagonal_deg", "field of view, diagonal", _DEGREES, "deg"),
}
_ANGLE: _Shown = {
    "centre": ("centre_deg", "angle of a pixel at the centre", _DEGREES, "deg"),
    "corner": ("corner_deg", "angle of a pixel at the corner", _DEGREES, "deg"),
}
_FOCUS: _Shown = {
    "principal_distance": ("principal_distance_mm", "principal distance", 1e3, "mm"),
    "magnification": ("magnification", "magnification", 1.0, ""),
    "hyperfocal": ("hyperfocal_m", "hyperfocal distance", 1.0, "m"),
    "near": ("near_m", "in focus from", 1.0, "m"),
    "far": ("far_m", "in focus up to", 1.0, "m"),
    "depth_of_field": ("depth_of_field_m", "depth of field", 1.0, "m"),
}
_DIFFRACTION: _Shown = {
    "airy_diameter": ("airy_diameter_um", "Airy disc", 1e6, "um"),
    "airy_px": ("airy_px", "Airy disc", 1.0, "px"),
    "contrast": ("contrast", "diffraction MTF at Nyquist", 1.0, ""),
    "sharp_f_number": ("sharp_f_number", "f-number with an Airy disc of 2 px", 1.0, ""),
}
_EXPOSURE: _Shown = {
    "effective_f_number": ("effective_f_number", "effective f-number", 1.0, ""),
    "close_focus_stops": ("close_focus_stops", "light loss by close focus", 1.0, "stops"),
    "exposure_value": ("exposure_value", "exposure value, ISO 100", 1.0, "EV"),
}
_CIRCLE: _Shown = {
    "given": ("given_mm", "image circle", 1e3, "mm"),
    "needed": ("needed_mm", "image circle that the sensor needs", 1e3, "mm"),
}
_AT: _Shown = {
    "distance": ("distance_m", "distance", 1.0, "m"),
    "width": ("width_m", "width of the field", 1.0, "m"),
    "height": ("height_m", "height of the field", 1.0, "m"),
    "pixel": ("pixel_mm", "a pixel at the centre", 1e3, "mm"),
    "corner_pixel": ("corner_pixel_mm", "a pixel at the corner", 1e3, "mm"),
    "line_pairs": ("line_pairs_per_mm", "line pairs", 1e-3, "1/mm"),
    "blur_px": ("blur_px", "blur by defocus", 1.0, "px"),
    "motion_px": ("motion_px", "blur by motion", 1.0, "px"),
    "longest_exposure": ("longest_exposure_ms", "exposure for 1 px of motion", 1e3, "ms"),
    "exposure_stops": ("exposure_stops", "light lost by it", 1.0, "stops"),
    "disparity_px": ("disparity_px", "disparity", 1.0, "px"),
    "depth_error": ("depth_error_mm", "depth, ±", 1e3, "mm"),
}
_BOARD_AT: _Shown = {
    "distance": ("distance_m", "distance", 1.0, "m"),
    "smallest_px": ("smallest_square_px", "smallest {element}", 1.0, "px"),
    "largest_px": ("largest_square_px", "largest {element}", 1.0, "px"),
    "share": ("share", "share of the image", 1.0, ""),
    "square_for_share": ("square_for_share_mm", "{element} for the wanted share", 1e3, "mm"),
    "noise_px": ("noise_px", "noise of a corner", 1.0, "px"),
    "p_wrong": ("p_wrong", "probability of a wrong pose", 1.0, ""),
}
_SOLVED = {
    "f": ("focal length", 1e3, "mm"),
    "wd": ("working distance", 1.0, "m"),
    "sensor": ("sensor width", 1e3, "mm"),
}
_POSE = ("tx_mm", "ty_mm", "tz_mm", "rx_deg", "ry_deg", "rz_deg")
_POSE_FACTORS = (1e3, 1e3, 1e3, _DEGREES, _DEGREES, _DEGREES)


def document(report: OpticsReport) -> dict[str, Any]:
    """Return the report as plain data for --json; what is unknown is None."""
    return {
        "setup": _setup(report.setup),
        "solved": _solved(report.setup),
        "field_of_view": _plain(report.field_of_view, _FIELD),
        "pixel_angle": _plain(report.pixel_angle, _ANGLE),
        "focus": _plain(report.focus, _FOCUS),
        "diffraction": _plain(report.diffraction, _DIFFRACTION),
        "exposure": _plain(report.exposure, _EXPOSURE),
        "image_circle": _plain(report.image_circle, _CIRCLE),
        "distances": [_plain(at, _AT) for at in report.at],
        "board": None if report.board is None else _board(report, report.board),
        "missing": report.missing,
        "plot": report.plot,
    }


def _plain(record: object | None, shown: _Shown) -> dict[str, Any] | None:
    if record is None:
        return None
    return {key: _scale(getattr(record, name), factor) for name, (key, _, factor, _) in shown.items()}


def _scale(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _setup(setup: Setup) -> dict[str, Any]:
    options = setup.options
    sources = {_SOURCED[name]: source for name, source in setup.sources.items() if getattr(setup, name) is not None}
    return {
        "camera": options.camera,
        **(_plain(setup, _SETUP) or {}),
        "f_number": options.f_number,
        "wavelength_nm": 1e9 * options.wavelength,
        "sensor_mm": None if setup.sensor is None else [1e3 * side for side in setup.sensor],
        "image_size": setup.size,
        "sources": sources,
    }


_SOURCED = {name: key for name, (key, *_) in _SETUP.items()} | {"sensor": "sensor_mm", "size": "image_size"}


def _solved(setup: Setup) -> dict[str, Any] | None:
    if setup.options.solve is None or setup.solved is None:
        return None
    words, factor, unit = _SOLVED[setup.options.solve]
    wide = smallest_format(setup.solved) if setup.options.solve == "sensor" else None
    return {"what": words, "value": factor * setup.solved, "unit": unit, "format": wide and wide.name}


def _board(report: OpticsReport, plan: BoardPlan) -> dict[str, Any]:
    low, high = usable_range(report)
    return {
        "board": plan.options.board,
        "tilt_deg": _DEGREES * plan.options.tilt,
        "least_square_px": plan.least_px,
        "fits_from_m": plan.nearest,
        "large_enough_to_m": plan.farthest,
        "usable_m": [low, high] if low < high else None,
        "distances": [{**(_plain(at, _BOARD_AT) or {}), "pose_std": _pose(at)} for at in plan.at],
        "calibration": {"views": plan.options.views, "noise_px": plan.options.noise_px, "std": plan.calibration},
    }


def _pose(at: BoardAt) -> dict[str, float] | None:
    if at.sigma is None:
        return None
    return {key: factor * std for key, factor, std in zip(_POSE, _POSE_FACTORS, at.sigma, strict=True)}


def lens_rows(report: OpticsReport) -> Iterator[list[Any]]:
    """Yield what, value, unit and source of every figure that does not depend on a distance."""
    setup = report.setup
    yield from _rows(setup, _SETUP, setup.sources)
    if setup.sensor is not None:
        width, height = (1e3 * side for side in setup.sensor)
        words = f"{width:.4g} x {height:.4g}"
        yield ["sensor", words, "mm", setup.sources.get("sensor", "")]
        yield ["its diagonal", f"{hypot(width, height):.4g}", "mm", ""]
    for record, shown in (
        (report.field_of_view, _FIELD),
        (report.pixel_angle, _ANGLE),
        (report.focus, _FOCUS),
        (report.exposure, _EXPOSURE),
        (report.diffraction, _DIFFRACTION),
        (report.image_circle, _CIRCLE),
    ):
        yield from _rows(record, shown, {})


def _rows(record: object | None, shown: _Shown, sources: Mapping[str, str]) -> Iterator[list[Any]]:
    for name, (_, words, factor, unit) in shown.items():
        value = None if record is None else getattr(record, name)
        if value is not None:
            yield [words, in_words(value * factor), unit if isfinite(value) else "", sources.get(name, "")]


def in_words(value: float) -> str:
    """Return a number in four digits, infinity and nothing in words."""
    if isnan(value):
        return "no ray"
    return number_text(value) if isfinite(value) else "infinity"


def distance_table(report: OpticsReport) -> tuple[list[str], list[list[str]]]:
    """Return heads, one for each distance, and a row for every figure that is known."""
    return _columns(report.at), _figure_rows(report.at, _AT)


def board_table(plan: BoardPlan) -> tuple[list[str], list[list[str]]]:
    """Return heads, one for each distance, and rows: squares, share, noise, and the pose's standard deviations."""
    element = BOARD_TYPES[plan.board.type].element
    shown = {
        name: (key, words.format(element=element), factor, unit)
        for name, (key, words, factor, unit) in _BOARD_AT.items()
    }
    stds = [_pose(at) for at in plan.at]
    spread = [
        [f"pose, ± {key[:2]}, {key[3:]}", *("-" if std is None else f"{std[key]:.2g}" for std in stds)]
        for key in _POSE
        if any(std is not None for std in stds)
    ]
    return _columns(plan.at), _figure_rows(plan.at, shown) + spread


def _columns(records: Sequence[At]) -> list[str]:
    return ["figure", *(f"{in_words(record.distance)} m" for record in records)]


def _figure_rows(records: Sequence[At], shown: _Shown) -> list[list[str]]:
    """Return a row for each figure that is known for any of the records: its words with the unit, the values."""
    rows = []
    for name, (_, words, factor, unit) in shown.items():
        values: list[float | None] = [_scale(getattr(record, name), factor) for record in records]
        if name != "distance" and any(value is not None for value in values):
            figure = f"{words}, {unit}" if unit else words
            rows.append([figure, *("-" if value is None else in_words(value) for value in values)])
    return rows


def board_lines(report: OpticsReport, plan: BoardPlan) -> Iterator[str]:
    """Yield where the board can be used and how well the camera will be calibrated with it."""
    low, high = usable_range(report)
    ends = f"{BOARD_TYPES[plan.board.type].element}s have {plan.least_px:.3g} px or more up to {plan.farthest:.4g} m"
    fits = f"from {plan.nearest:.4g} m" if plan.nearest else "at any distance"
    yield f"it fits the image {fits}, and {ends}"
    if low < high:
        sharp = " in focus" if report.focus is not None and report.focus.near is not None else ""
        yield f"use it{sharp} between {low:.4g} m and {in_words(high)} m"
    if plan.calibration is not None:
        std = ", ".join(f"{name} {value:.2g}" for name, value in plan.calibration.items())
        yield f"calibration from {plan.options.views} views, corners of {plan.options.noise_px:g} px: ± {std}"


def board_title(plan: BoardPlan) -> str:
    """Return which board the table is of."""
    tilt = f", tilted by {_DEGREES * plan.options.tilt:g}°" if plan.options.tilt else ""
    return f"board {plan.options.board}{tilt}"


def closing_lines(report: OpticsReport) -> Iterator[str]:
    """Yield what was solved, what to know, what what is missing for more."""
    if (solved := _solved(report.setup)) is not None:
        wide = f"; smallest format of this width {solved['format']}" if solved["format"] else ""
        length = f"{solved['value']:.4g} {solved['unit']}"
        yield f"{solved['what']} {length} for a width of {report.setup.options.width:g} m{wide}"
    yield from (f"for {figure} give {options}" for figure, options in report.missing.items())


FORMAT_NOTE = (
    "The inch of a format is that of an old camera tube: 1/2.8 inch is a name, its diagonal is about 6.4 mm and not "
    "9.1 mm. Makers differ by a few percent: pixels times pitch is exact (--size and --pitch-um)."
)


def format_rows() -> list[list[Any]]:
    """Return name, width, height, diagonal (mm), and what the inch in the name would be (mm, None without one)."""
    return [
        [one.name, one.width_mm, one.height_mm, round(one.diagonal_mm, 2), literal_mm(one)] for one in FORMATS.values()
    ]


def formats_document() -> dict[str, Any]:
    """Return the sensor formats as plain data for --json."""
    listed = [asdict(one) | {"diagonal_mm": one.diagonal_mm} for one in FORMATS.values()]
    return {"formats": listed, "note": FORMAT_NOTE}
