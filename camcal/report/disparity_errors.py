"""The errors of disparity maps as rows of tables."""

from collections.abc import Sequence
from math import isnan

from camcal.stereo.truth.evaluate import FIGURES, ClassErrors, Evaluation

CLASS_COLUMNS = ("class", "pixels", "share", "68 % of errors", "sigma", "within 1", "within 2", "bad1", "bad2")

_PERCENT = ("density", "bad", "d1", "within")


def figure_rows(evaluation: Evaluation) -> list[list[object]]:
    """Return a row for each figure: its name, a number for each column or None, and the unit."""
    columns = list(evaluation.figures)
    rows: list[list[object]] = [["pixels", *(evaluation.pixels[column] for column in columns), ""]]
    for name in FIGURES:
        values = [evaluation.figures[column].get(name) for column in columns]
        if any(value is not None for value in values):
            rows.append([name, *(_short(value) for value in values), _unit(name)])
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


def _unit(name: str) -> str:
    if name.startswith(_PERCENT) or name.endswith("percent"):
        return "%"
    return "m" if name.endswith("_m") else "px"
