"""The check of a rectified pair as text and as plain data, and errors of disparity maps as table rows."""

from collections.abc import Sequence
from math import isnan
from typing import Any

from camcal.report.table import Column, value_and_std
from camcal.stereo.alignment import LARGEST_CORRECTION, NEGLIGIBLE, WORTH_RECTIFYING, Measured
from camcal.stereo.pair_check import Exposure, PairCheck
from camcal.stereo.rectify.record import AXES
from camcal.stereo.truth import FIGURES, ClassErrors, Evaluation

_SIGNIFICANT = 3.0  # standard errors
CHECK_COLUMNS = (
    Column("left", file=True),
    Column("median dy", "px"),
    Column("± std", "px"),
    Column("RMS", "px"),
    Column("95 %", "px", priority=2),
    Column("disparity", "px", priority=1),
    Column("verdict", wraps=True),
)
CLASS_COLUMNS = (
    Column("class"),
    Column("pixels"),
    Column("share", "%"),
    Column("68 % of errors", "px"),
    Column("sigma", "px"),
    Column("within 1", "%", priority=2),
    Column("within 2", "%", priority=3),
    Column("bad1", "%"),
    Column("bad2", "%", priority=1),
)
_PERCENT = ("density", "bad", "d1", "within")


def line_of(check: PairCheck) -> str:
    """Return what corresponding points have in common, a row or, of cameras above each other, a column."""
    return "column" if check.upright else "row"


def lines(check: PairCheck) -> list[str]:
    """Return what was found of a pair, a line each."""
    residual = check.residual
    trend = residual.trend
    said = [headline(check)]
    if 0 < trend.largest <= LARGEST_CORRECTION:
        along, across = ("from left to right", "from top to bottom")[:: -1 if check.upright else 1]
        shape = f"{_signed(trend.tilt)} {along}, {_signed(trend.scale)} {across}"
        said.append(f"trend: {_signed(trend.centre)} px at the centre, {shape}")
    if residual.convergence is not None and abs(residual.convergence.value) > _SIGNIFICANT * residual.convergence.std:
        said.append(f"{line_of(check)} difference by disparity: {_signed(residual.convergence)} px per px")
    said.append(f"disparity {spanned(*check.disparity)} px{_search_words(check)}")
    if check.exposure is not None:
        said.append(light(check.exposure))
    return said


def check_row(check: PairCheck) -> list[object]:
    """Return the cells of a pair under CHECK_COLUMNS, without the first."""
    residual = check.residual
    sizes = f"{residual.rms:.2f}", f"{residual.p95:.2f}"
    return [*value_and_std(*residual.median), *sizes, spanned(*check.disparity), verdict(check)]


def headline(check: PairCheck) -> str:
    """Return the residual across the baseline in a line."""
    residual, line = check.residual, line_of(check)
    features = f"{residual.agreeing} inlier features of {residual.seen}"
    if not residual.rms:
        return f"{line}s do not differ ({features})"
    if residual.trend.largest > LARGEST_CORRECTION:  # beyond it a plane over the image describes nothing
        return f"{line}s differ by up to {residual.largest:.0f} px ({features})"
    return (
        f"{line}s differ by {_signed(residual.median)} px (median of {features}), RMS {residual.rms:.2f} px, "
        f"95 % within {residual.p95:.2f} px"
    )


def spanned(low: float, high: float) -> str:
    """Return a range of disparities in whole pixels."""
    ends = dict.fromkeys((f"{low:z.0f}", f"{high:z.0f}"))
    return " … ".join(ends)


def light(exposure: Exposure) -> str:
    """Return what differs between the exposures of a pair."""
    percent, std = value_and_std(abs(100 * exposure.brightness.value), 100 * exposure.brightness.std)
    if not float(percent):
        return "exposures agree"
    side = "brighter" if exposure.brightness.value > 0 else "darker"
    said = f"the right image is {percent} ± {std} % {side}"
    if not exposure.differs:
        return f"exposures agree: {said}"
    return f"{said} (gain {exposure.gain:.2f}, gamma {exposure.gamma:.2f}, offset {exposure.offset:+.0f} of 255)"


def agrees(check: PairCheck) -> bool:
    """Return whether the rows of a pair agree as they are."""
    return check.failure is None and check.residual.trend.rms <= NEGLIGIBLE


def verdict(check: PairCheck) -> str:
    """Return whether the pair can be matched, and what to do."""
    if check.failure is not None:
        return check.failure.text
    trend, line = check.residual.trend, line_of(check)
    off = f"{line} differences {trend.rms:.2f} px"
    if trend.largest > LARGEST_CORRECTION:
        limit = f"more than the {LARGEST_CORRECTION:g} px that are corrected"
        return f"these images are not rectified: {line}s differ by {limit}"
    if trend.rms > WORTH_RECTIFYING:
        return f"{off}: worth a new calibration and rectification; --align-rows auto of 'stereo disparity' helps"
    if trend.rms > NEGLIGIBLE:
        return f"{off}: --align-rows auto of 'stereo disparity' corrects it"
    return f"{line}s agree"


def plain(check: PairCheck) -> dict[str, Any]:
    """Return the check as plain data: pixels, and counts of 255."""
    residual, exposure = check.residual, check.exposure
    trend = residual.trend
    named = {"centre": trend.centre, "tilt": trend.tilt, "scale": trend.scale}
    low, high = check.disparity
    return {
        "size": residual.size[::-1] if check.upright else residual.size,
        "axis": AXES[int(check.upright)],
        "features": {"seen": residual.seen, "agreeing": residual.agreeing},
        "rows_px": {
            "median": _plain(residual.median),
            "rms": residual.rms,
            "p95": residual.p95,
            "scatter": residual.scatter,
        },
        "trend_px": {name: _plain(value) for name, value in named.items()}
        | {"rms": trend.rms, "largest": trend.largest},
        "rows_per_disparity": None if residual.convergence is None else _plain(residual.convergence),
        "disparity_px": {"low": low, "high": high, "search": check.searched},
        "exposure": None
        if exposure is None
        else {
            "brightness": _plain(exposure.brightness),
            **{name: getattr(exposure, name) for name in ("gain", "offset", "gamma", "scatter")},
            "differs": exposure.differs,
        },
        "failure": None if check.failure is None else check.failure.code,
        "verdict": verdict(check),
    }


def _search_words(check: PairCheck) -> str:
    if check.searched is None:
        return "; too few matches for the search range"
    return "; search range {}:{}".format(*check.searched)


def _signed(measured: Measured) -> str:
    value, std = value_and_std(*measured)
    number = float(value)
    signed = f"+{value}" if number > 0 else value if number else value.removeprefix("-")
    return f"{signed} ± {std}" if measured.std else signed


def _plain(measured: Measured) -> dict[str, float]:
    return {"value": measured.value, "std": measured.std}


def figure_rows(evaluation: Evaluation) -> list[list[object]]:
    """Return a row for each figure: its name with the unit, and a number for each column or None."""
    columns = list(evaluation.figures)
    rows: list[list[object]] = [["pixels", *(evaluation.pixels[column] for column in columns)]]
    for name in FIGURES:
        values = [evaluation.figures[column].get(name) for column in columns]
        if any(value is not None for value in values):
            rows.append([_with_unit(name), *(_short(value) for value in values)])
    return rows


def class_rows(classes: Sequence[ClassErrors]) -> list[list[object]]:
    """Return a row for each confidence class; columns as in CLASS_COLUMNS, percent and pixels."""
    return [
        [kind.name, kind.pixels, *map(_short, (kind.share, kind.error68, kind.sigma, kind.within1, kind.within2)),
         *map(_short, (kind.bad1, kind.bad2))]
        for kind in classes
    ]  # fmt: skip


def _short(value: float | None) -> float | None:
    """Return a number to four digits, None where there is nothing to count."""
    return None if value is None or isnan(value) else float(f"{value:.4g}")


def _with_unit(name: str) -> str:
    """Return a figure with its unit, where its name does not say it."""
    if name.endswith(("_percent", "_m")):
        return name
    return f"{name}, {'%' if name.startswith(_PERCENT) else 'px'}"
