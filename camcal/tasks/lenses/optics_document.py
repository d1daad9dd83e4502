"""The figures of `camcal optics` as plain data for --json and as table rows, in practical units."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from math import hypot, isfinite, isnan, pi
from typing import Any, TypeVar

from camcal import records
from camcal.optics.lens import FORMATS, literal_mm, smallest_format
from camcal.report.table import number_text
from camcal.targets.board_types import BOARD_TYPES
from camcal.tasks.lenses.board_plan import POSE, BoardAt, BoardPlan
from camcal.tasks.lenses.optics import OpticsReport, usable_range
from camcal.tasks.lenses.optics_figures import AtDistance
from camcal.tasks.lenses.optics_setup import Setup

_DEGREES = 180 / pi

At = TypeVar("At", AtDistance, BoardAt)

_SOLVED = {
    "f": ("focal length", 1e3, "mm"),
    "wd": ("working distance", 1.0, "m"),
    "sensor": ("sensor width", 1e3, "mm"),
}


def document(report: OpticsReport) -> dict[str, Any]:
    """Return the report as plain data for --json; what is unknown is None."""
    return {
        "setup": _setup(report.setup),
        "solved": _solved(report.setup),
        **records.figures(report),
        "board": None if report.board is None else _board(report, report.board),
        "missing": report.missing,
        "plot": report.plot,
    }


def _setup(setup: Setup) -> dict[str, Any]:
    options = setup.options
    keys = {"sensor": "sensor_mm", "size": "image_size"} | {name: how.key for name, how in records.entries(setup).items()}
    sources = {keys[name]: source for name, source in setup.sources.items() if getattr(setup, name) is not None}
    return {
        "camera": options.camera,
        **records.figures(setup),
        "f_number": options.f_number,
        "wavelength_nm": 1e9 * options.wavelength,
        "sensor_mm": None if setup.sensor is None else [1e3 * side for side in setup.sensor],
        "image_size": setup.size,
        "sources": sources,
    }


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
        "distances": plan.at,
        "calibration": {"views": plan.options.views, "noise_px": plan.options.noise_px, "std": plan.calibration},
    }


def lens_rows(report: OpticsReport) -> Iterator[list[Any]]:
    """Yield what, value, unit and source of every figure that does not depend on a distance."""
    setup = report.setup
    yield from _rows(setup, setup.sources)
    if setup.sensor is not None:
        width, height = (1e3 * side for side in setup.sensor)
        words = f"{width:.4g} x {height:.4g}"
        yield ["sensor", words, "mm", setup.sources.get("sensor", "")]
        yield ["its diagonal", f"{hypot(width, height):.4g}", "mm", ""]
    parts = (report.field_of_view, report.pixel_angle, report.focus, report.exposure, report.diffraction)
    for record in (*parts, report.image_circle):
        yield from _rows(record, {}) if record is not None else ()


def _rows(record: object, sources: Mapping[str, str]) -> Iterator[list[Any]]:
    for name, how in records.entries(record).items():
        if (value := getattr(record, name)) is not None:
            yield [how.words, in_words(how.of(value)), how.unit if isfinite(value) else "", sources.get(name, "")]


def in_words(value: float) -> str:
    """Return a number in four digits, infinity and nothing in words."""
    if isnan(value):
        return "no ray"
    return number_text(value) if isfinite(value) else "infinity"


def distance_table(report: OpticsReport) -> tuple[list[str], list[list[str]]]:
    """Return heads, one for each distance, and a row for every figure that is known."""
    return _columns(report.at), _figure_rows(report.at)


def board_table(plan: BoardPlan) -> tuple[list[str], list[list[str]]]:
    """Return heads, one for each distance, and rows: squares, share, noise, and the pose's standard deviations."""
    stds = [records.document(at)["pose_std"] for at in plan.at]
    spread = [
        [f"pose, ± {key[:2]}, {key[3:]}", *("-" if std is None else f"{std[key]:.2g}" for std in stds)]
        for key in POSE
        if any(std is not None for std in stds)
    ]
    return _columns(plan.at), _figure_rows(plan.at, BOARD_TYPES[plan.board.type].element) + spread


def _columns(at: Sequence[At]) -> list[str]:
    return ["figure", *(f"{in_words(record.distance)} m" for record in at)]


def _figure_rows(at: Sequence[At], element: str = "") -> list[list[str]]:
    """Return a row for each figure that is known at any of the distances: its words with the unit, the values.

    element: what the words call the squares of a board.
    """
    rows = []
    for name, how in (records.entries(at[0]) if at else {}).items():
        values: list[float | None] = [how.of(getattr(record, name)) for record in at]
        if name != "distance" and how.words and any(value is not None for value in values):
            figure = how.words.format(element=element) + (f", {how.unit}" if how.unit else "")
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
