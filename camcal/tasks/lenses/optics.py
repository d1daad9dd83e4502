"""`camcal optics`: field of view, sharpness, and expected accuracy with a board, as a record, document and table."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from math import degrees, hypot, isfinite, isnan, pi
from pathlib import Path
from typing import Any, TypeVar

from camcal import files, records
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.estimate.poses.records import AMBIGUOUS, WEAK_TURN
from camcal.formats.boards import load_board
from camcal.messages import Message
from camcal.optics import FORMATS, literal_mm, smallest_format
from camcal.progress import SILENT, Progress, warn_of
from camcal.records import entry
from camcal.report.table import number_text
from camcal.run.outputs import writes
from camcal.targets.board_types import BOARD_TYPES
from camcal.tasks.lenses import optics_figures as part
from camcal.tasks.lenses.board_plan import POSE, BoardAt, BoardPlan, plan_board
from camcal.tasks.lenses.optics_figures import AtDistance
from camcal.tasks.lenses.optics_setup import Setup, set_up
from camcal.tasks.lenses.options import OpticsOptions


@dataclass(frozen=True, eq=False)
class OpticsReport:
    """What is known of a setup; a part that is None cannot be computed, and `missing` says what it needs.

    at: figures at the distances asked for, or at the focus.
    """

    setup: Setup
    field_of_view: part.FieldOfView | None = field(metadata=entry())
    pixel_angle: part.PixelAngle | None = field(metadata=entry())
    focus: part.Focus | None = field(metadata=entry())
    diffraction: part.Diffraction | None = field(metadata=entry())
    exposure: part.Exposure | None = field(metadata=entry())
    image_circle: part.ImageCircle | None = field(metadata=entry())
    at: tuple[part.AtDistance, ...] = field(metadata=entry("distances"))
    board: BoardPlan | None
    missing: Mapping[str, str]
    warnings: tuple[Message, ...]
    plot: Path | None


@writes
def optics(options: OpticsOptions, progress: Progress = SILENT) -> OpticsReport:
    """Return all that can be said of a lens in use, after drawing its blur over distance if a file is named.

    Raises InvalidInput for options that contradict each other, or that say too little for any figure, for the board
    or for the plot; FileError for a file that cannot be read or written.
    """
    report = _report(set_up(options))
    if options.plot is not None:
        _draw(report, options.plot)
    warn_of(report.warnings, progress)
    return report


def _report(setup: Setup) -> OpticsReport:
    plan, plot = setup.options.plan, setup.options.plot
    distances = setup.options.distances or tuple(value for value in (setup.focus,) if value and isfinite(value))
    report = OpticsReport(
        setup=setup,
        field_of_view=part.angles_of_view(setup),
        pixel_angle=part.pixel_angle(setup),
        focus=part.focus(setup),
        diffraction=part.diffraction(setup),
        exposure=part.exposure(setup),
        image_circle=part.image_circle(setup),
        at=tuple(part.at_distance(setup, distance) for distance in distances),
        board=None if plan.board is None else plan_board(setup, load_board(plan.board), plan, distances),
        missing=part.missing(setup),
        warnings=(),
        plot=plot,
    )
    _require_something(report)
    found = (*_lens_warnings(report), *_distance_warnings(report), *_board_warnings(report))
    return replace(report, warnings=(*setup.warnings, *found))


def _require_something(report: OpticsReport) -> None:
    parts = (report.field_of_view, report.pixel_angle, report.focus, report.image_circle)
    sampled = report.diffraction is not None and report.diffraction.airy_px is not None
    exposed = report.exposure is not None and report.exposure.exposure_value is not None
    if not (exposed or sampled) and all(one is None for one in parts):
        raise InvalidInput(
            "too few inputs: give a CAMERA file; --focal and --sensor for the field of view, "
            "--focus and --f-number too for the depth of field; --formats lists sensors"
        )


def _lens_warnings(report: OpticsReport) -> Iterator[Message]:
    field, circle, blur = report.field_of_view, report.image_circle, report.diffraction
    if field is not None and any(map(isnan, (field.horizontal, field.vertical, field.diagonal))):
        text = "lens model not invertible at the edge of the image: no field of view there"
        yield Message("no_field_of_view", text)
    if circle is not None and circle.given < circle.needed:
        given, needed = 1e3 * circle.given, 1e3 * circle.needed
        text = f"image circle of {given:g} mm too small: the sensor corners need {needed:.2f} mm"
        yield Message("image_circle_too_small", text, {"given_mm": given, "needed_mm": needed})
    if blur is not None and blur.limited:
        text = (
            f"diffraction-limited: Airy disc {blur.airy_px:.1f} px, MTF at Nyquist {blur.contrast:.0%}; use "
            f"f/{blur.sharp_f_number:.1f} or less"
        )
        yield Message("diffraction_limited", text, {"f_number": float(blur.sharp_f_number or 0)})


def _distance_warnings(report: OpticsReport) -> Iterator[Message]:
    sharp = report.focus
    for at in report.at:
        if at.motion_px is not None and at.longest_exposure is not None and at.motion_px > 1:
            text = f"motion blur {at.motion_px:.1f} px: expose for {1e3 * at.longest_exposure:.3g} ms or less"
            yield Message("motion_blur_expected", text, {"blur_px": at.motion_px}, f"{at.distance:g} m")
        if sharp is None or sharp.near is None or sharp.far is None:
            continue
        if not sharp.near <= at.distance <= sharp.far:
            disc = "" if at.blur_px is None else f": blur disc {at.blur_px:.1f} px"
            values = {} if at.blur_px is None else {"blur_px": at.blur_px}
            yield Message("out_of_focus", f"out of focus{disc}", values, f"{at.distance:g} m")


def _board_warnings(report: OpticsReport) -> Iterator[Message]:
    plan = report.board
    if plan is None:
        return
    element = BOARD_TYPES[plan.board.type].element
    low, high = usable_range(report)
    if low >= high:
        text = (
            f"no usable distance for this board: it fits the image from {plan.nearest:.3g} m, its {element}s are large "
            f"enough up to {plan.farthest:.3g} m{_sharp_words(report)}"
        )
        yield Message("no_usable_distance", text, {"nearest_m": plan.nearest, "farthest_m": plan.farthest})
    for at in plan.at:
        yield from (message.at(f"{at.distance:g} m") for message in _warnings_at(at, plan, element))
    if plan.reason is not None:
        yield Message("no_forecast", f"no forecast of a calibration: {plan.reason}")


def _warnings_at(at: BoardAt, plan: BoardPlan, element: str) -> Iterator[Message]:
    if at.share > 1:
        text = f"board larger than the image; nearest distance {plan.nearest:.3g} m"
        yield Message("board_exceeds_image", text, {"nearest_m": plan.nearest})
    elif at.smallest_px < plan.least_px:
        text = f"{element}s of {at.smallest_px:.1f} px (limit {plan.least_px:.3g} px)"
        yield Message("board_too_small", text, {"smallest_px": at.smallest_px, "limit_px": plan.least_px})
    if at.sigma is not None and (turn := max(at.sigma[3:])) > WEAK_TURN:
        text = f"standard deviation of the board rotation {degrees(turn):.2g}°"
        yield Message("weak_rotation", text, {"std_deg": degrees(turn)})
    if at.p_wrong is not None and at.p_wrong > AMBIGUOUS:
        text = f"probability of a wrong pose {100 * at.p_wrong:.2g} %"
        yield Message("ambiguous_forecast", text, {"p_wrong": at.p_wrong})


def usable_range(report: OpticsReport) -> tuple[float, float]:
    """Return between which distances (m) a board fits the image, is in focus and has large enough squares."""
    plan, sharp = report.board, report.focus
    if plan is None:
        raise ValueError("the report has no board")
    low, high = plan.nearest, plan.farthest
    if sharp is not None and sharp.near is not None and sharp.far is not None:
        low, high = max(low, sharp.near), min(high, sharp.far)
    return low, high


def _sharp_words(report: OpticsReport) -> str:
    sharp = report.focus
    if sharp is None or sharp.near is None:
        return ""
    return f", and {sharp.near:.3g} m to {sharp.far:.3g} m are in focus"


def _draw(report: OpticsReport, plot: Path) -> None:
    """Write the blur over distance; raises InvalidInput if the depth of field is not known."""
    from camcal.report.figures.figure import encoded
    from camcal.report.figures.over_time import BlurCurve, blur_over_distance

    setup, sharp = report.setup, report.focus
    if sharp is None or sharp.near is None or sharp.far is None:
        raise InvalidInput(f"--plot needs the depth of field: give {report.missing['depth of field']} too")
    known = (setup.focal, setup.options.f_number, setup.focus, setup.circle)
    focal, number, focus, circle = (float(value or 0) for value in known)
    disc = None if report.diffraction is None else report.diffraction.airy_diameter
    curve = BlurCurve(
        focal=focal,
        f_number=number,
        focus=focus,
        circle=circle,
        near=sharp.near,
        far=sharp.far,
        pitch=setup.pitch,
        airy_diameter=disc,
    )
    files.write_bytes(plot, encoded(blur_over_distance(curve), plot.suffix))


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
    keys = {"sensor": "sensor_mm", "size": "image_size"} | {
        name: how.key for name, how in records.entries(setup).items()
    }
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
