"""`camcal stereo check`: checks of rectified pairs before matching."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import CamcalError, GateFailed
from camcal.images.files import gray_8bit, load
from camcal.messages import Message
from camcal.progress import SILENT, Outcome, Progress, failed_items, warn_of
from camcal.report import stereo_words as words
from camcal.report.stereo_pictures import SUFFIXES, picture_of
from camcal.run.fanout import fan_out, only_outcome
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_pairs, place
from camcal.stereo.pair_check import PairCheck, check_pair
from camcal.tasks.given_camera import Size
from camcal.tasks.options import GivenCamera
from camcal.tasks.stereo.options import GeometryOptions, StereoCheckOptions
from camcal.tasks.stereo.rectified_pair import RectifiedPair, pair_of, warn_of_file
from camcal.tasks.stereo.rig_pair import PairImages, RigPair, read_pair, unrectified_pair

_SUFFIX = "_check.png"
_STEP_PX = 1e-3  # of the row offsets that all pairs together are judged by

Pair = tuple[Path, Path]


@dataclass(frozen=True, eq=False)
class CheckedPair:
    """A pair, the figures of what was found of it, and its picture if one was asked for.

    offsets: (N, 2) by how much the rows of features are off, in multiples of `_STEP_PX`, and of how many features.
    """

    left: Path
    right: Path
    check: PairCheck
    offsets: Array
    picture: Path | None


@dataclass(frozen=True)
class Overall:
    """All pairs together: features, root mean square and 95 % of how far their rows are off, pixels, and the worst."""

    pairs: int
    features: int
    median: float
    rms: float
    p95: float
    worst: Path


@writes
def stereo_check(options: StereoCheckOptions, progress: Progress = SILENT) -> list[Outcome[Pair, CheckedPair]]:
    """Return what became of every pair, in natural order; one that fails costs only itself.

    Raises InvalidInput and FileError for inputs that are no pairs, and whatever kept a single pair from being checked.
    """
    pairs = find_pairs(options.left, options.right, options.recursive)
    pictures = _pictures(pairs, options.output)
    warn_of_file(options.camera_file, progress)
    rig = unrectified_pair(options.camera_file, options.camera, lambda: load(pairs[0][0]).size, options.part)
    if rig is not None:
        warn_of(rig.rectification.warnings, progress)
    given = GeometryOptions(options.camera, GivenCamera(part=options.part))
    known = partial(pair_of, given, options.camera_file)
    work = partial(_check_files, pictures=pictures, known=known, rig=rig)
    jobs, batch = options.jobs, options.batch
    if len(pairs) == 1:
        outcomes = [only_outcome(work, pairs[0], batch)]
    else:
        found = fan_out(work, pairs, jobs=jobs, batch=batch, processes=True, what="stereo check", progress=progress)
        outcomes = list(found)
    for outcome in outcomes:
        pair = outcome.value
        if pair is not None and pair.check.failure is not None:
            progress.warn(pair.check.failure.at(pair.left))
    return outcomes


def overall(outcomes: Sequence[Outcome[Pair, CheckedPair]]) -> Overall | None:
    """Return all pairs that were checked together, None if none was."""
    checked = [outcome.value for outcome in outcomes if outcome.value is not None]
    if not checked:
        return None
    residuals = [pair.check.residual for pair in checked]
    features = sum(residual.agreeing for residual in residuals)
    steps, counts = _count_values(np.concatenate([pair.offsets for pair in checked]))
    sizes, of_sizes = _count_values(np.column_stack([np.abs(steps), counts]))
    return Overall(
        len(checked),
        features,
        _STEP_PX * _quantile(steps, counts, 0.5),
        float(np.sqrt(sum(residual.agreeing * residual.rms**2 for residual in residuals) / features)),
        _STEP_PX * _quantile(sizes, of_sizes, 0.95),
        max(checked, key=lambda pair: pair.check.residual.rms).left,
    )


def _count_values(rows: Array) -> tuple[Array, Array]:
    """Return the different values of rows (N, 2) of values and counts, in order, and how often each occurs."""
    values, members = np.unique(rows[:, 0], return_inverse=True)
    return values, np.bincount(members.ravel(), rows[:, 1])


def _quantile(values: Array, counts: Array, share: float) -> float:
    """Return the smallest of values, in order and with their counts, that a share of all does not exceed."""
    reached = np.cumsum(counts)
    return float(values[np.searchsorted(reached, share * reached[-1])])


def require_good(outcomes: Sequence[Outcome[Pair, CheckedPair]], max_rms: float | None) -> None:
    """Raise GateFailed for pairs that cannot be matched or whose rows differ by more than max_rms; None: no gate."""
    if max_rms is None:
        return
    checked = [outcome.value for outcome in outcomes if outcome.value is not None]
    failures = [failure.at(pair.left) for pair in checked if (failure := _failure(pair.check, max_rms))]
    if failures:
        raise GateFailed.of(failures, where="--max-rms")


def document(outcomes: Sequence[Outcome[Pair, CheckedPair]]) -> dict[str, Any]:
    """Return what became of the pairs as plain data for --json."""
    checked = [outcome.value for outcome in outcomes if outcome.value is not None]
    together = overall(outcomes)
    return {
        "pairs": [
            {"left": pair.left, "right": pair.right, **words.plain(pair.check), "picture": pair.picture}
            for pair in checked
        ],
        "overall": together,
        "failed": failed_items(outcomes, "left", "right"),
    }


def _pictures(pairs: Sequence[Pair], output: Path | None) -> Mapping[Path, Path]:
    if output is None:
        return {}
    pictures = place([left for left, _ in pairs], output, _SUFFIX, SUFFIXES)
    claim(pictures.values())
    return pictures


def _check_files(
    pair: Pair, pictures: Mapping[Path, Path], known: Callable[[Size], RectifiedPair], rig: RigPair | None
) -> CheckedPair:
    images = read_pair(pair, rig, known)
    left, right = images.paths
    try:
        check = check_images(images)
    except CamcalError as error:
        raise type(error)(error.message, where=error.where or f"{left}, {right}") from error
    picture = pictures.get(pair[0])
    if picture is not None:
        files.write_bytes(picture, picture_of(check, _gray_pair(images.left, images.right)[0]))
    steps, counts = np.unique(np.rint(check.residual.dy / _STEP_PX).astype(np.int32), return_counts=True)
    offsets = np.column_stack([steps, counts.astype(np.int32)])
    return CheckedPair(left, right, check.figures(), offsets, picture)


def check_images(images: PairImages) -> PairCheck:
    """Return the check of rectified images, of cameras above each other that of their columns.

    Raises InvalidInput for images of different sizes, InsufficientData if they share too few features.
    """
    geometry = images.known.geometry
    upright = geometry is not None and geometry.upright
    return check_pair(*_gray_pair(images.left, images.right), images.known.farthest, upright=upright)


def _gray_pair(left: Array, right: Array) -> tuple[Array, Array]:
    """Return two images (H, W) uint8; those of more than 8 bits by one scale, so that their light can be compared.

    Of 8 and 16 bits both are taken for the whole range of their type.
    """
    if {left.dtype, right.dtype} == {np.dtype(np.uint8), np.dtype(np.uint16)}:
        left, right = (image * np.uint16(257) if image.dtype == np.uint8 else image for image in (left, right))
    if left.dtype == right.dtype == np.uint8 or left.shape != right.shape:
        return gray_8bit(left), gray_8bit(right)
    both = gray_8bit(np.concatenate([left, right]))
    return both[: len(left)], both[len(left) :]


def _failure(check: PairCheck, max_rms: float) -> Message | None:
    rms = check.residual.rms
    if check.failure is not None or rms <= max_rms:
        return check.failure
    text = f"{words.line_of(check)} differences {rms:.2f} px RMS (limit {max_rms:g} px)"
    return Message("row_differences", text, {"rms_px": rms, "limit_px": max_rms})
