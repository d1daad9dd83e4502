"""A matched pair of `camcal stereo disparity`: its files, its figures, and both as plain data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.formats import disparity_sidecar
from camcal.progress import Outcome
from camcal.stereo.disparity import Confidence, Disparity

_KINDS = ("sigma.tiff", "confidence.png", "vis.png")

Pair = tuple[Path, Path]
Limits = tuple[float, float]


class MapFiles(NamedTuple):
    """What is written of one pair, each named by the map: x.pfm, x.pfm.sigma.tiff and so on."""

    map: Path
    sigma: Path
    confidence: Path
    picture: Path
    sidecar: Path

    @classmethod
    def beside(cls, path: Path) -> "MapFiles":
        sigma, confidence, picture = (path.with_name(f"{path.name}.{kind}") for kind in _KINDS)
        return cls(path, sigma, confidence, picture, disparity_sidecar.path_beside(path))


@dataclass(frozen=True)
class Figures:
    """A map in numbers.

    size: (width, height), pixels. searched: smallest and largest disparity looked for, pixels. at_ends: shares of the
    pixels whose best match lies at either of them. matched: share of those that are matched and not filled. filled:
    share that is. classes: share of each `Confidence`. median: of the disparities, pixels, None without any. sigma:
    median of their standard deviations, pixels, None if unknown.
    """

    size: tuple[int, int]
    searched: tuple[int, int]
    at_ends: tuple[float, float]
    matched: float
    filled: float
    classes: Mapping[str, float]
    median: float | None
    sigma: float | None

    @classmethod
    def of(cls, disparity: Disparity) -> "Figures":
        height, width = disparity.values.shape
        shares = np.bincount(disparity.confidence.ravel(), minlength=len(Confidence)) / disparity.values.size
        return cls(
            size=(width, height),
            searched=disparity.searched,
            at_ends=disparity.at_ends,
            matched=float(shares[Confidence.SINGLE :].sum()),
            filled=float(shares[Confidence.FILLED]),
            classes={each.name.lower(): float(shares[each]) for each in Confidence},
            median=_median(disparity.values),
            sigma=_median(disparity.sigma),
        )


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None


@dataclass(frozen=True)
class MatchedPair:
    """A pair and its map.

    rows: by which the right image was aligned, px RMS. scale: counts of the file per pixel of disparity. limits: of
    the colours of a picture. geometry_known: whether the sidecar holds it. failures: why it is no pair, or its map is
    worth nothing.
    """

    left: Path
    right: Path
    output: Path
    figures: Figures
    rows: float
    scale: float
    picture: Path | None
    limits: Limits
    geometry_known: bool
    remarks: tuple[str, ...]
    failures: tuple[str, ...]


def document(outcomes: Sequence[Outcome[Pair, MatchedPair]]) -> dict[str, Any]:
    """Return what became of the pairs as plain data for --json."""
    matched = [outcome.value for outcome in outcomes if outcome.value is not None]
    return {
        "pairs": [_plain(pair) for pair in matched],
        "failed": [
            {"left": left.as_posix(), "right": right.as_posix(), "message": str(outcome.error)}
            for outcome in outcomes
            if outcome.error is not None
            for left, right in (outcome.item,)
        ],
    }


def _plain(pair: MatchedPair) -> dict[str, Any]:
    figures = pair.figures
    return {
        "left": pair.left.as_posix(),
        "right": pair.right.as_posix(),
        "output": pair.output.as_posix(),
        "sidecar": disparity_sidecar.path_beside(pair.output).as_posix(),
        "picture": None if pair.picture is None else pair.picture.as_posix(),
        "image_size": list(figures.size),
        "searched": list(figures.searched),
        "at_ends": list(figures.at_ends),
        "matched": figures.matched,
        "filled": figures.filled,
        "classes": dict(figures.classes),
        "median_px": figures.median,
        "sigma_px": figures.sigma,
        "rows_px": pair.rows,
        "scale": pair.scale,
        "geometry": pair.geometry_known,
        "remarks": list(pair.remarks),
        "failures": list(pair.failures),
    }
