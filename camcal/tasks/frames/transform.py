"""`camcal transform chain`, `eval`, `compose` and `invert`: transforms made of others; where results go."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np

from camcal import files
from camcal.errors import InsufficientData, InvalidInput
from camcal.formats import frames, pose_text
from camcal.formats.pose_text import Form, form_of
from camcal.geometry.frame_graph import FrameGraph, Loop
from camcal.geometry.frame_graph import evaluate as evaluate_product
from camcal.geometry.pose import Derived, Key, NamedTransform
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.report.rig import plain, plain_loop
from camcal.run.outputs import writes
from camcal.run.pose_sources import read_transforms
from camcal.tasks.frames.options import ChainOptions, ExpressionOptions, Output, PosesOptions

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
