"""`camcal transform chain`, `eval`, `compose`, `invert`, `average` and `check`: transforms made of others.

The mean of several estimates of one transform; how far poses, as they are written, are from being any.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np

from camcal import files
from camcal.dataclass import dataclass, replace
from camcal.errors import GateFailed, InsufficientData, InvalidInput
from camcal.estimate.pose_average import PoseAverage, average_poses
from camcal.formats import frames, pose_text
from camcal.formats.frames import LooseTransform
from camcal.formats.pose_text import Form, LoosePose, form_of
from camcal.geometry import rotation as so3
from camcal.geometry.frame_graph import FrameGraph, Loop
from camcal.geometry.frame_graph import evaluate as evaluate_product
from camcal.geometry.pose import Derived, Key, NamedTransform, Pose, frames_of
from camcal.geometry.rotation import MAX_ORTHONORMALITY_ERROR, Orthogonality, examine
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.report.rig import plain, plain_loop
from camcal.run.outputs import writes
from camcal.run.pose_sources import read_loose, read_trajectories, read_transforms
from camcal.tasks.transform_options import (
    AverageOptions,
    ChainOptions,
    CheckOptions,
    ExpressionOptions,
    Output,
    PosesOptions,
)

_CONSISTENT = 27.86  # χ² of 6 degrees of freedom that chance exceeds once in 10 000 times


@dataclass(frozen=True, eq=False)
class TransformResult:
    """Transforms, and what each was made of, as one writes it.

    exact: names of those without a covariance where others have one.
    loops: among the transforms that are joined with the chain's.
    """

    transforms: tuple[NamedTransform, ...]
    products: tuple[str, ...]
    exact: tuple[str, ...] = ()
    loops: tuple[Loop, ...] = ()


@writes
def chain(options: ChainOptions, progress: Progress = SILENT) -> TransformResult:
    """Return target_T_source by way of the fewest transforms.

    Raises InvalidInput where the frames are not joined or a loop does not close, FileError.
    """
    transforms = _named(read_transforms(options.sources, form_of(options.form)))
    graph = FrameGraph(transforms)
    links = graph.path(options.target, options.source)
    loops = tuple(graph.loops(options.target))
    for loop in loops:
        _require_closed(loop, options)
    factors = {link.index: transforms[link.index] for link in links}
    result = _with_covariance((options.target, options.source), graph.along(links), factors)
    write(options.output, [result])
    return TransformResult((result,), (_product(map(graph.name_of, links)),), _exact(factors, progress), loops)


@writes
def evaluate(options: ExpressionOptions, progress: Progress = SILENT) -> TransformResult:
    """Return the product that an expression says; raises InvalidInput if inner frames do not cancel, FileError."""
    transforms: dict[str, NamedTransform] = {}
    for item in _named(read_transforms(options.sources, form_of(options.form))):
        if item.name in transforms:
            raise InvalidInput(f"{item.name} is also in {transforms[item.name].where}", where=item.where)
        transforms[item.name] = item
    product = evaluate_product(options.expression, transforms)
    used = {name: item for name, item in transforms.items() if name in product.derived.by}
    result = _with_covariance((product.target, product.source), product.derived, used)
    write(options.output, [result])
    return TransformResult((result,), (product.text,), _exact(used, progress))


@writes
def compose(options: PosesOptions, progress: Progress = SILENT) -> TransformResult:
    """Return the product of transforms in their order; frames that are not named are taken to fit.

    Raises InvalidInput where named frames do not meet, FileError.
    """
    transforms = read_transforms(options.sources, form_of(options.form))
    if len(transforms) < 2:
        raise InvalidInput(f"{len(transforms)} transform only: a product needs two or more")
    for left, right in pairwise(transforms):
        if left.source and right.target and left.source != right.target:
            raise InvalidInput(f"{left.name} * {right.name}: {left.source!r} does not meet {right.target!r}")
    factors = dict(enumerate(transforms))
    derived = reduce(
        lambda left, right: left @ right, (Derived.of(index, item.pose) for index, item in factors.items())
    )
    ends = (transforms[0].target, transforms[-1].source) if all(item.name for item in transforms) else ("", "")
    result = _with_covariance(ends, derived, factors)
    write(options.output, [result])
    return TransformResult((result,), (_product(item.called for item in transforms),), _exact(factors, progress))


@writes
def invert(options: PosesOptions, _: Progress = SILENT) -> TransformResult:
    """Return the inverse of every transform; raises InvalidInput, FileError."""
    transforms = read_transforms(options.sources, form_of(options.form))
    inverses = tuple(item.inverse() for item in transforms)
    write(options.output, inverses)
    return TransformResult(inverses, tuple(f"inv({item.called})" for item in transforms))


def document(made: TransformResult, output: Output) -> dict[str, Any]:
    """Return transforms and what they were made of as plain data for --json."""
    return {
        "transforms": [plain(transform, output.numbers) for transform in made.transforms],
        "products": made.products,
        "exact": made.exact,
        "loops": [plain_loop(loop) for loop in made.loops],
        "output": output.path,
    }


def _with_covariance(
    ends: tuple[str, str], derived: Derived[Key], factors: Mapping[Key, NamedTransform]
) -> NamedTransform:
    """Return what was derived from factors as a transform between two frames, with the covariance that follows."""
    return NamedTransform(*ends, derived.pose, derived.covariance_of(factors))


def _product(factors: Iterable[str]) -> str:
    return " * ".join(factors) or "nothing"


def _named(transforms: Sequence[NamedTransform]) -> Sequence[NamedTransform]:
    """Return transforms all of which have names; raises InvalidInput for one that has none."""
    for item in transforms:
        if not item.name:
            raise InvalidInput(f"unknown frames: write a_T_b={item.where} with the frame names", where=item.where)
    return transforms


def _exact(used: Mapping[Any, NamedTransform], progress: Progress) -> tuple[str, ...]:
    """Return the transforms taken as exact beside others that are not, after saying so."""
    without = tuple(item.called for item in used.values() if item.covariance is None)
    if not without or len(without) == len(used):
        return ()
    progress.warn(
        Message("assumed_exact", f"no covariance, assumed exact: {', '.join(without)}", {"transforms": without})
    )
    return without


def _require_closed(loop: Loop, options: ChainOptions) -> None:
    offset_mm, angle_deg = 1000 * loop.offset, float(np.degrees(loop.angle))
    far = f"{' * '.join(loop.names)} is {offset_mm:.3g} mm and {angle_deg:.3g}° from identity"
    if loop.chi_square is not None:
        if loop.chi_square > _CONSISTENT:
            raise InvalidInput(f"{far}, χ² = {loop.chi_square:.3g} with 6 degrees of freedom: check the transforms")
    elif offset_mm > options.loop_mm or angle_deg > options.loop_deg:
        limit = f"{options.loop_mm:g} mm and {options.loop_deg:g}°"
        raise InvalidInput(f"{far}, more than {limit}: check the transforms, or increase --loop-mm, --loop-deg")


def write(output: Output, transforms: Sequence[NamedTransform]) -> None:
    """Write transforms if they go anywhere.

    Raises InvalidInput for several in a text, or two of one name, InsufficientData for none.
    """
    path = output.path
    if path is None:
        return
    if not transforms:
        raise InsufficientData("no transforms to write", where=str(path))
    if files.is_stream(path) or path.suffix.lower() in frames.SUFFIXES:
        named = [item if item.name else replace(item, target="a", source="b") for item in transforms]
        frames.write(path, named, output.numbers)
        return
    if len(transforms) != 1:
        raise InvalidInput(f"{len(transforms)} transforms cannot be written as text; use .yaml", where=str(path))
    files.write_text(path, pose_text.text_of(transforms[0], output.numbers or Form("matrix")))


EXACT = 1e-6  # what a camera file asks of its rotations
OK = "ok"
INEXACT = "inexact"
REFLECTION = "reflection"
NONE = "no pose"

_FAR = 3.0  # standard deviations of χ² above its mean


@dataclass(frozen=True, eq=False)
class Averaged:
    """The mean as a transform, what it is the mean of, and how these lie about it; weighted: by their covariances."""

    transform: NamedTransform
    estimates: tuple[NamedTransform, ...]
    mean: PoseAverage
    weighted: bool


@writes
def average(options: AverageOptions, progress: Progress = SILENT) -> Averaged:
    """Return the mean of transforms that all have one name, or none.

    Raises InvalidInput for transforms of other frames, FileError, InsufficientData for fewer than two, NotConverged.
    """
    estimates = _estimates(options)
    for item in estimates:
        if item.name != estimates[0].name:
            text = f"{item.called} and {estimates[0].called} are different transforms: a mean is of one"
            raise InvalidInput(text, where=item.where)
    covariances = [item.covariance for item in estimates if item.covariance is not None]
    weighted = not options.equal and bool(estimates) and len(covariances) == len(estimates)
    if covariances and not weighted and not options.equal:
        text = (
            f"{len(estimates) - len(covariances)} of {len(estimates)} estimates have no covariance: equal weights used"
        )
        progress.warn(Message("equal_weights", text, {"without_covariance": len(estimates) - len(covariances)}))
    poses = [item.pose for item in estimates]
    mean = average_poses(poses, covariances if weighted else None, robust=options.robust)
    _warn(mean, progress)
    first = estimates[0]
    result = NamedTransform(first.target, first.source, mean.pose, mean.covariance)
    write(options.output, [result])
    return Averaged(result, estimates, mean, weighted)


def _estimates(options: AverageOptions) -> tuple[NamedTransform, ...]:
    if not options.trajectory:
        return read_transforms(options.sources, form_of(options.form))
    if options.form is not None:
        raise InvalidInput("--form applies to numbers, not to trajectory files")
    return read_trajectories(options.sources)


def average_document(averaged: Averaged, output: Output) -> dict[str, Any]:
    """Return the mean and the estimates as plain data for --json."""
    mean = averaged.mean
    return {
        "transform": plain(averaged.transform, output.numbers),
        "weighted": averaged.weighted,
        "unique": mean.unique,
        "chi_square": mean.chi_square,
        "degrees_of_freedom": mean.degrees_of_freedom,
        "estimates": [
            {"name": item.name or None, "where": item.where, "weight": weight, "offset_m": offset, "angle_deg": angle}
            for item, weight, offset, angle in zip(
                averaged.estimates, mean.weights, mean.offsets, np.degrees(mean.angles), strict=True
            )
        ],
        "output": output.path,
    }


def _warn(mean: PoseAverage, progress: Progress) -> None:
    if not mean.unique:
        largest = float(np.degrees(mean.angles.max()))
        text = f"rotations up to {largest:.0f}° from their mean: the mean may not be unique"
        progress.warn(Message("mean_not_unique", text, {"angle_deg": largest}))
    if mean.chi_square is not None and mean.chi_square > mean.degrees_of_freedom + _FAR * np.sqrt(
        2 * mean.degrees_of_freedom
    ):
        text = (
            f"estimates differ more than their covariances (χ² = {mean.chi_square:.4g}, "
            f"{mean.degrees_of_freedom} degrees of freedom): --equal estimates the covariance from their scatter"
        )
        values = {"chi_square": mean.chi_square, "degrees_of_freedom": mean.degrees_of_freedom}
        progress.warn(Message("inconsistent_estimates", text, values))


@dataclass(frozen=True, eq=False)
class CheckedPose:
    """A pose as it is written, what its nine numbers are, and the verdict: ok, inexact, reflection or no pose."""

    written: LooseTransform
    found: Orthogonality
    verdict: str

    @property
    def called(self) -> str:
        """Where the pose stands, and its name if it has one: all poses of a pose file have the same."""
        name = self.written.name
        return f"{self.written.where}: {name}" if name else self.written.where

    @property
    def row(self) -> list[object]:
        """The cells of a table: name, verdict, orthonormality error, determinant, angle in degrees, length."""
        angle = None if np.isnan(self.found.angle) else float(np.degrees(self.found.angle))
        return [self.called, self.verdict, self.found.error, self.found.determinant, angle, self.written.pose.norm]

    @property
    def failure(self) -> Message:
        """Why it is not a pose."""
        norm = self.written.pose.norm
        if norm is not None and abs(norm - 1) > EXACT:
            return Message("quaternion_norm", f"quaternion norm {norm:.9g}, not 1", {"norm": norm}, self.called)
        if text := self.found.fault(EXACT):
            return Message("not_a_rotation", text, {"determinant": self.found.determinant}, self.called)
        off = self.written.pose.strays
        return Message("last_row", f"last row differs from 0 0 0 1 by {off:.3g}", {"difference": off}, self.called)


@dataclass(frozen=True, eq=False)
class Checked:
    """What was found of every pose, and the nearest poses of those that have one, if that was asked for."""

    poses: tuple[CheckedPose, ...]
    fixed: tuple[NamedTransform, ...]


@writes
def check(options: CheckOptions, _: Progress = SILENT) -> Checked:
    """Return what was found of poses; raises InvalidInput, FileError for what is not even numbers."""
    poses = []
    for written in read_loose(options.sources, form_of(options.form)):
        found = examine(written.pose.matrix)
        poses.append(CheckedPose(written, found, _verdict(written.pose, found)))
    fixed = tuple(_fixed(pose.written) for pose in poses if pose.verdict in {OK, INEXACT}) if options.fix else ()
    if fixed:
        write(options.output, fixed)
    return Checked(tuple(poses), fixed)


def require_good(checked: Checked, *, fix: bool) -> None:
    """Raise GateFailed with the failures of all that are not poses; inexact ones pass if they were to be fixed."""
    passing = {OK, INEXACT} if fix else {OK}
    failures = [pose.failure for pose in checked.poses if pose.verdict not in passing]
    if failures:
        raise GateFailed.of(failures)


def check_document(checked: Checked, output: Output) -> dict[str, Any]:
    """Return what was found as plain data for --json."""
    return {
        "poses": [
            {
                "name": pose.written.name or None,
                "where": pose.written.where,
                "verdict": pose.verdict,
                "orthonormality_error": pose.found.error,
                "determinant": pose.found.determinant,
                "angle_to_nearest_deg": float(np.degrees(pose.found.angle)),
                "quaternion_length": pose.written.pose.norm,
            }
            for pose in checked.poses
        ],
        "fixed": [plain(transform, output.numbers) for transform in checked.fixed],
        "output": output.path,
    }


def _verdict(pose: LoosePose, found: Orthogonality) -> str:
    if found.is_reflection:
        return REFLECTION
    stretched = 0.0 if pose.norm is None else abs(pose.norm - 1)
    if not found.can_be_fixed or stretched > MAX_ORTHONORMALITY_ERROR or pose.strays > EXACT:
        return NONE
    return OK if found.is_rotation(EXACT) and stretched <= EXACT else INEXACT


def _fixed(written: LooseTransform) -> NamedTransform:
    frames = frames_of(written.name) if written.name else ("", "")
    pose = Pose(so3.nearest(written.pose.matrix), written.pose.translation)
    return NamedTransform(*frames, pose, written.covariance, written.where)
