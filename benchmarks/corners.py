"""Errors of chessboard corners beside the least that the image allows, ours and OpenCV's, over rendered conditions.

Every cell of the grid is one set of conditions (blur, noise, spacing, tilt, lens, gamma, depth, JPEG), each with some
photographs. Ratios are RMS errors over the root of the mean Cramér-Rao bound (corner_scenes.bound): made from the
renderer's own picture and noise, not from residuals. NEES is eᵀ Σ⁻¹ e / 2 with the covariances that camcal claims, 1 if
they are honest. cornerSubPix gets, in every cell, the window of 2 … 11 px that does best there.

    python benchmarks/corners.py [--scenes 3] [--every 1] [--jobs 2] [--renderer]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from unittest import mock

import numpy as np
from corner_scenes import BOARD, Cell, Scene, bound, grid, scenes
from peers.opencv_corners import SECTOR_BASED, refined, sector_based

from camcal import opencv
from camcal.arrays import Array
from camcal.images.files import gray_8bit, gray_levels
from camcal.run.fanout import fan_out
from camcal.simulate.render import piece_length
from camcal.targets.detect import detect
from camcal.targets.detection import MaskedImage

WINDOWS = (2, 3, 4, 5, 7, 9, 11)
PEERS = (*SECTOR_BASED, "cornerSubPix")
SEED = 2026
FINER = 8  # times, the steps of outlines that show the renderer's own error
CONDITIONS: dict[str, Callable[[Cell], float | str]] = {
    "blur px": lambda cell: cell.blur_px,
    "noise DN": lambda cell: cell.noise_dn,
    "spacing px": lambda cell: cell.spacing_px,
    "tilt deg": lambda cell: cell.tilt_deg,
    "distortion": lambda cell: cell.distortion,
    "encoding": lambda cell: "JPEG 90" if cell.jpeg else f"{cell.depth} bit, gamma {cell.gamma:g}",
}


@dataclass(frozen=True)
class Score:
    """A cell's figures: RMS error and bound (px per axis), NEES / 2, share of corners found, RMS errors of peers."""

    cell: Cell
    rms: float
    bound: float
    nees: float
    found: float
    peers: dict[str, float]

    @property
    def ratio(self) -> float:
        return self.rms / self.bound


def main() -> None:
    """Print a line for every cell, and what they come to."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--every", type=int, default=1, help="take one cell of so many")
    parser.add_argument("--jobs", type=int, default=None)
    parser.add_argument("--no-peers", action="store_true")
    parser.add_argument("--renderer", action="store_true", help="print the renderer's own error alone")
    options = parser.parse_args()
    if options.renderer:
        renderer_error()
        return
    cells = [cell for cell in grid()[:: options.every] if not cell.apart]
    work = partial(score, count=options.scenes, peers=not options.no_peers)
    print(
        " blur noise space tilt  lens gamma bit jpeg |  RMS mpx bound ratio  NEES found |"
        + " ".join(f"{p:>12}" for p in PEERS)
    )
    scores = []
    for outcome in fan_out(work, cells, jobs=options.jobs, processes=True):
        if outcome.value is None:
            raise RuntimeError(f"{outcome.item}: {outcome.error}")
        scores.append(outcome.value)
        print(line(outcome.value), flush=True)
    summary(scores)


def renderer_error() -> None:
    """Print by how much corners move when outlines are drawn in finer steps, against the least bound of such a blur."""
    for blur in (0.5, 1.0, 2.5):
        cell = Cell(blur, 0.0, 80, 30, 0.1, depth=16)
        view = next(scenes(cell, 1, SEED))
        least = np.sqrt(np.trace(bound(replace(view, cell=replace(cell, noise_dn=1.0))), axis1=1, axis2=2).min() / 2)
        usual = detect(gray_8bit(view.image), BOARD, samples=MaskedImage(view.image))
        with mock.patch("camcal.simulate.render.piece_length", lambda blur_px: piece_length(blur_px) / FINER):
            finer = next(scenes(cell, 1, SEED)).image
        moved = detect(gray_8bit(finer), BOARD, samples=MaskedImage(finer)).pixels - usual.pixels
        rms = np.sqrt((moved**2).mean())
        print(f"blur {blur}: {1e3 * rms:.3f} of {1e3 * least:.2f} mpx, the bound of noise 1 DN: {rms / least:.3f}")


def line(item: Score) -> str:
    """Return a cell's line of the table."""
    c = item.cell
    given = f"{c.blur_px:5.1f} {c.noise_dn:5.1f} {c.spacing_px:5.0f} {c.tilt_deg:4.0f}"
    given += f" {c.distortion:5.2f} {c.gamma:5.1f} {c.depth:3d} {c.jpeg:4d}"
    ours = f"{1e3 * item.rms:8.2f} {1e3 * item.bound:5.2f} {item.ratio:5.2f} {item.nees:5.2f} {item.found:5.2f}"
    return f"{given} | {ours} |" + " ".join(f"{1e3 * item.peers.get(name, np.nan):12.1f}" for name in PEERS)


def summary(scores: Sequence[Score]) -> None:
    """Print medians and extremes of all cells, and of those that share a condition."""
    print("| cells | number | ratio: median, worst | NEES: median, least, worst | best of OpenCV / camcal: median |")
    print("|---|---|---|---|---|")
    print(group("all", scores))
    for name, condition in CONDITIONS.items():
        for value in sorted({condition(item.cell) for item in scores}):
            print(group(f"{name} {value}", [item for item in scores if condition(item.cell) == value]))


def group(name: str, scores: Sequence[Score]) -> str:
    """Return the line of the table for some cells."""
    ratios, nees = np.array([item.ratio for item in scores]), np.array([item.nees for item in scores])
    gains = [min(item.peers.values()) / item.rms for item in scores if item.peers]
    gain = f"{np.median(gains):.1f}" if gains else "-"
    return (
        f"| {name} | {len(scores)} | {np.median(ratios):.2f}, {ratios.max():.2f} | "
        f"{np.median(nees):.2f}, {nees.min():.2f}, {nees.max():.2f} | {gain} |"
    )


def score(cell: Cell, count: int, peers: bool) -> Score:
    """Return the figures of a cell."""
    squares, least, nees, seen = [], [], [], 0
    errors: dict[str, list[Array]] = {name: [] for name in PEERS}
    windows: dict[int, list[Array]] = {window: [] for window in WINDOWS}
    for view in scenes(cell, count, SEED):
        detection = detect(gray_8bit(view.image), BOARD, samples=MaskedImage(gray_levels(view.image)))
        seen += len(detection.ids)
        limits = bound(view)
        if detection.found:
            off = detection.pixels - view.corners[detection.ids]
            squares.append((off**2).sum(axis=1) / 2)
            least.append(np.trace(limits[detection.ids], axis1=1, axis2=2) / 2)
            nees.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(detection.covariance), off) / 2)
        if peers:
            _peers(view, errors, windows)
    rms = {name: _root(parts) for name, parts in errors.items() if parts}
    if any(windows.values()):
        rms["cornerSubPix"] = min(_root(parts) for parts in windows.values() if parts)
    found = seen / (count * BOARD.count)
    if not squares:
        return Score(cell, np.nan, np.nan, np.nan, found, rms)
    return Score(cell, _root(squares), _root(least), float(np.mean(np.concatenate(nees))), found, rms)


def _peers(view: Scene, errors: dict[str, list[Array]], windows: dict[int, list[Array]]) -> None:
    gray = gray_8bit(view.image)
    starts = []
    with opencv.repeatable(0):
        for name, flags in SECTOR_BASED.items():
            corners = sector_based(gray, BOARD, flags)
            if corners is not None:
                starts.append(corners)
                errors[name].append(_errors(corners, view.corners))
        for window in WINDOWS if starts else ():
            windows[window].append(_errors(refined(gray, starts[0], window), view.corners))


def _errors(pixels: Array, corners: Array) -> Array:
    """Return half the squared distance (N,) from every true corner to the nearest one found."""
    squared = ((pixels[None] - corners[:, None]) ** 2).sum(axis=-1)
    return np.asarray(squared.min(axis=1) / 2)


def _root(parts: Sequence[Array]) -> float:
    return float(np.sqrt(np.concatenate(parts).mean()))


if __name__ == "__main__":
    main()
