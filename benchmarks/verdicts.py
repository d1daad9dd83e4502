"""Halves of real sets, calibrated as `camcal calibrate` does: lens model, verdict, remedy, and how far they differ.

A row for each set: halves, how many are trusted, the lens models taken; of the trusted and of the others the RMS
distance in px between the images that the two lenses of a split have of the same directions, at infinity, after the
best rotation: the median and the largest over the splits, within the region that both verdicts state (within the hull
of the corners where one is refused); the same over what the two covariances lead to expect; the RMS distance in px of
the corners of one half under the lens of the other, posed anew. 'own' counts refusals that name another lens model,
and of how many of these that model, followed, is trusted.

    python benchmarks/verdicts.py --detections FOLDER [--splits 4] [--sets NAME …] [--models NAME …] [--jobs 2]

--models: forced lens models instead of the choice. Tables as of split_halves.py.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import re
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from split_halves import ALL_SETS, divisions, grid_within, held_out, read_views

from camcal.calibrate.intrinsics import Calibration, Options
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.directions import direction_displacements
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.geometry import rotation as so3
from camcal.quality.projection_uncertainty import in_polygon, projection_uncertainty
from camcal.run.fanout import fan_out
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.model_selection import select, solve_given


@dataclass(frozen=True, eq=False)
class Half:
    """What came of a half: its calibration, the codes of its failures or the refusal, and all that was said."""

    calibration: Calibration | None
    codes: tuple[str, ...]
    said: str
    seconds: float
    polygon: np.ndarray | None = None

    @property
    def trusted(self) -> bool:
        return self.calibration is not None and not self.codes


@dataclass(frozen=True)
class Row:
    """A split: models taken, whether trusted, px observed, expected and held out, codes, remedies named and kept."""

    models: tuple[str, str]
    trusted: tuple[bool, bool]
    observed: float
    expected: float
    held_out: float
    codes: tuple[str, ...]
    named: int
    kept: int
    seconds: float
    worst: float


def half(board: Board, views: list[BoardDetection], model: str | None) -> Half:
    start = time.process_time()
    try:
        how = Options(model_named(model or DEFAULT_MODEL))
        found = (select if model is None else solve_given)(views, board, how)
    except (CamcalError, ValueError, ArithmeticError) as error:
        return Half(None, ("refused",), str(error), time.process_time() - start)
    own, assessment = found.calibration, found.assessment
    said = "; ".join(message.text for message in assessment.messages)
    seconds = time.process_time() - start
    return Half(own, tuple(message.code for message in assessment.failures), said, seconds, assessment.region.polygon)


def difference(one: Camera, other: Camera, pixels: np.ndarray) -> float:
    """RMS distance in px between the images of the directions of pixels, after the rotation that suits best."""
    rays = one.unproject(pixels).directions
    good, turn = np.isfinite(rays).all(axis=1), np.zeros(3)
    for _ in range(8):
        turned = rays @ so3.exp(turn).T
        found = other.model.project_with_jacobians(other.parameters, turned)
        apart = found.pixels - pixels
        crossed = np.einsum("nij,njk->nik", found.d_point, -so3.hat(turned))
        use = good & np.isfinite(apart).all(axis=1) & np.isfinite(crossed).all(axis=(1, 2))
        step = np.linalg.lstsq(crossed[use].reshape(-1, 3), -apart[use].ravel(), rcond=None)[0]
        turn = so3.log(so3.exp(step) @ so3.exp(turn))
    return float(np.sqrt(np.mean(np.sum(apart[use] ** 2, axis=1))))


def expected(one: Camera, other: Camera, pixels: np.ndarray) -> float:
    total = 0.0
    for camera in (one, other):
        moved = direction_displacements(camera, pixels)
        moved = moved[np.isfinite(moved).all(axis=(1, 2))]
        total += float(np.mean(np.einsum("nik,kl,nil->n", moved, camera.covariance, moved)))
    return float(np.sqrt(total))


def worst_of(own: Calibration) -> float:
    figures = projection_uncertainty(own.camera, observed=own.pixels).figures()
    return figures.get("worst_px", np.nan)


def rows(folder: Path, splits: int, task: tuple[str, str | None]) -> tuple[str, str | None, list[Row]]:
    name, model = task
    board, views = read_views(folder, name)
    result = []
    for parts in divisions(views, splits):
        halves = [half(board, part, model) for part in parts]
        named = kept = 0
        for own, part in zip(halves, parts, strict=True):
            if not own.trusted and (wanted := re.search(r"--model (\w+)", own.said)):
                named += 1
                kept += half(board, part, wanted[1]).trusted
        observed = predicted = away = np.nan
        if all(own.calibration is not None for own in halves):
            one, other = (own.calibration for own in halves)
            pixels = grid_within(np.concatenate([one.pixels, other.pixels]))
            for own in halves:
                if own.trusted and own.polygon is not None:
                    pixels = pixels[in_polygon(pixels, own.polygon)]
            if len(pixels) > 20:
                observed = difference(one.camera, other.camera, pixels)
                predicted = expected(one.camera, other.camera, pixels)
            squares = []
            for own, part in ((one, parts[1]), (other, parts[0])):
                squares.append(held_out(own.camera.model, own.camera.parameters, own.surface.points(), part))
            everything = np.concatenate(squares)
            limit = 6 * np.median(everything)
            away = float(np.sqrt(np.mean(np.minimum(np.nan_to_num(everything, nan=limit, posinf=limit), limit) ** 2)))
        result.append(
            Row(
                tuple(own.calibration.camera.model.name if own.calibration else "-" for own in halves),
                tuple(own.trusted for own in halves),
                observed,
                predicted,
                away,
                tuple(code for own in halves for code in own.codes),
                named,
                kept,
                sum(own.seconds for own in halves) / 2,
                max(worst_of(own.calibration) if own.trusted else 0.0 for own in halves),
            )
        )
    return name, model, result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--detections", type=Path, required=True)
    parser.add_argument("--sets", nargs="+", choices=ALL_SETS, default=list(ALL_SETS), metavar="NAME")
    parser.add_argument("--splits", type=int, default=4)
    parser.add_argument("--models", nargs="+", default=[None])
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    tasks = [(name, model) for name in arguments.sets for model in arguments.models]
    work = partial(rows, arguments.detections, arguments.splits)
    everything: list[Row] = []
    for outcome in fan_out(work, tasks, jobs=arguments.jobs, processes=True):
        if outcome.value is None:
            print(f"{outcome.item}: {outcome.error}", flush=True)
            continue
        name, model, found = outcome.value
        everything += found
        print(f"{name:17} {model or '':16} {words(found)}", flush=True)
    print(f"{'all':34} {words(everything)}")


def words(found: list[Row]) -> str:
    both = [row for row in found if all(row.trusted) and np.isfinite(row.observed)]
    others = [row for row in found if not all(row.trusted) and np.isfinite(row.observed)]
    trusted = sum(sum(row.trusted) for row in found)
    models = Counter(model for row in found for model in row.models)
    codes = Counter(code for row in found for code in row.codes)
    parts = [f"{trusted}/{2 * len(found)} trusted"]
    for label, some in (("both", both), ("other", others)):
        if some:
            observed = np.array([row.observed for row in some])
            ratio = observed / np.array([row.expected for row in some])
            ends = observed.max() if label == "both" else observed.min()
            root = np.sqrt(np.mean(ratio**2))
            parts.append(f"{label} {np.median(observed):.3f} ({ends:.3f}) px, /expected {root:.2f}")
    parts.append(f"held-out {np.sqrt(np.nanmean([row.held_out**2 for row in found])):.4f}")
    parts.append(f"worst trusted {max((row.worst for row in found), default=0):.1f}")
    parts.append(f"own {sum(row.named for row in found)}/{sum(row.kept for row in found)}")
    parts.append(f"{np.mean([row.seconds for row in found]):.1f} s")
    parts.append(", ".join(f"{name} {count}" for name, count in models.most_common()))
    parts.append(", ".join(f"{code} {count}" for code, count in codes.most_common()))
    return "; ".join(filter(None, parts))


if __name__ == "__main__":
    main()
