"""`camcal transform` and its commands."""

from pathlib import Path
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.call import Call
from camcal.report.table import Column
from camcal.tasks.transform_options import (
    AverageOptions,
    ChainOptions,
    CheckOptions,
    ConvertOptions,
    ExpressionOptions,
    Output,
    PointsOptions,
    PosesOptions,
)

if TYPE_CHECKING:
    from camcal.tasks.transform import Averaged, Checked, TransformResult
    from camcal.tasks.transform_convert import Converted, MovedPoints

ESTIMATE_COLUMNS = (Column("pose", file=True), Column("weight"), Column("off by", "mm"), Column("off by", "deg"))
CHECK_COLUMNS = (
    Column("pose", file=True),
    Column("verdict", wraps=True),
    Column("|R Rᵀ - I|"),
    Column("det R"),
    Column("angle to a rotation", "deg", priority=1),
    Column("|q|", priority=2),
)


def chain(options: ChainOptions, call: Call) -> None:
    """Chain the transforms between two named frames, with covariance.

    Frames are connected by their names. For loops of transforms the closure error is reported; a loop that does not
    close is refused.
    """
    from camcal.tasks.transform import chain as run

    _give(run(options, call.progress), options.output, call)


def evaluate(options: ExpressionOptions, call: Call) -> None:
    """Evaluate a product of named transforms; inner frames must cancel.

    A transform that occurs twice is one random variable: if it cancels, so does its uncertainty.
    """
    from camcal.tasks.transform import evaluate as run

    _give(run(options, call.progress), options.output, call)


def compose(options: PosesOptions, call: Call) -> None:
    """Multiply poses in their order: a_T_b, then b_T_c, gives a_T_c.

    Adjacent frame names must match; poses without names match any frame.
    """
    from camcal.tasks.transform import compose as run

    _give(run(options, call.progress), options.output, call)


def invert(options: PosesOptions, call: Call) -> None:
    """Invert poses, all of a file if it holds several: b_T_a from a_T_b, the covariance with it."""
    from camcal.tasks.transform import invert as run

    _give(run(options, call.progress), options.output, call)


def _give(made: "TransformResult", output: Output, call: Call) -> None:
    from camcal.tasks.transform import document

    call.give(lambda: document(made, output), lambda: _show_made(made, output, verbose=call.verbose))


def _show_made(made: "TransformResult", output: Output, *, verbose: bool) -> None:
    """Print transforms and what they were made of; beside bare numbers only where ways differ, as remarks."""
    from camcal.report.rig import loop_lines, transform_lines

    if output.numbers is not None and made.loops:
        for line in (f"made of {made.products[0]}", *loop_lines(made.loops)):
            show.text(f"# {line}")
    for transform, factors in zip(made.transforms, made.products, strict=True):
        for line in transform_lines(transform, output.numbers, verbose=verbose):
            show.text(line)
        if output.numbers is None:
            show.text(f"  {'made of':<20}  {factors}")
    if output.numbers is None:
        for line in loop_lines(made.loops):
            show.text(line)
    _wrote(output)


def convert(options: ConvertOptions, call: Call) -> None:
    """Convert poses to another representation or axis convention.

    Unity is left-handed: change the axes of both frames, otherwise the result is no rotation.
    """
    from camcal.tasks.transform_convert import convert as run
    from camcal.tasks.transform_convert import document

    if options.output.trajectory:
        _convert_trajectory(options, call)
        return
    converted = run(options, call.progress)
    where = options.output
    call.give(lambda: document(converted, where), lambda: _show_converted(converted, where, verbose=call.verbose))


def _show_converted(converted: "Converted", output: Output, *, verbose: bool) -> None:
    from camcal.report.rig import transform_lines

    for transform in converted.transforms:
        for line in transform_lines(transform, output.numbers, verbose=verbose):
            show.text(line)
    _wrote(output)


def _convert_trajectory(options: ConvertOptions, call: Call) -> None:
    from camcal.tasks.transform_convert import convert_trajectory, trajectory_document

    converted = convert_trajectory(options, call.progress)
    count, frames = len(converted.trajectory), converted.trajectory.frames
    call.give(
        lambda: trajectory_document(converted), lambda: _show_trajectory(f"{count} poses {frames}", converted.output)
    )


def _show_trajectory(line: str, output: Path) -> None:
    show.text(line)
    show.wrote(output)


def average(options: AverageOptions, call: Call) -> None:
    """Average several estimates of one pose, weighted by their covariances if all have one.

    The mean of rotations is the Karcher mean, which minimises the sum of squared angles.
    """
    from camcal.tasks.transform import average as run
    from camcal.tasks.transform import average_document

    averaged = run(options, call.progress)
    where = options.output
    call.give(lambda: average_document(averaged, where), lambda: _show_average(averaged, where, verbose=call.verbose))


def _show_average(averaged: "Averaged", output: Output, *, verbose: bool) -> None:
    from camcal.report.rig import average_line, estimate_rows, transform_lines

    for line in transform_lines(averaged.transform, output.numbers, verbose=verbose):
        show.text(line)
    if output.numbers is None:
        show.text(average_line(averaged.mean, weighted=averaged.weighted))
        rows = estimate_rows(averaged.estimates, averaged.mean)
        show.table("estimates", ESTIMATE_COLUMNS, rows, verbose=verbose, most=show.LISTED)
    _wrote(output)


def check(options: CheckOptions, call: Call) -> None:
    """Check whether poses are valid: orthonormality, determinant, norm of quaternions. Exit with 7 if one is not.

    A determinant of -1 is a reflection (a flipped axis or a left-handed frame) and is never corrected.
    """
    from camcal.tasks.transform import check as run
    from camcal.tasks.transform import check_document, require_good

    checked = run(options, call.progress)
    where = options.output
    call.give(lambda: check_document(checked, where), lambda: _show_check(checked, where, verbose=call.verbose))
    require_good(checked, fix=options.fix)


def _show_check(checked: "Checked", output: Output, *, verbose: bool) -> None:
    from camcal.report.rig import transform_lines

    if output.numbers is None:
        show.table("checked", CHECK_COLUMNS, [pose.row for pose in checked.poses], verbose=verbose)
    for transform in checked.fixed:
        for line in transform_lines(transform, output.numbers, verbose=verbose):
            show.text(line)
    if checked.fixed:
        _wrote(output)


def points(options: PointsOptions, call: Call) -> None:
    """Transform the points of a file to another frame, with normals and covariances.

    In a CSV the uncertainty of the transform is added to that of every point. It is common to all points and does not
    average out.
    """
    from camcal.tasks.transform_convert import points_document, transform_points

    moved = transform_points(options, call.progress)
    call.give(lambda: points_document(moved), lambda: _show_points(moved, verbose=call.verbose))


def _show_points(moved: "MovedPoints", *, verbose: bool) -> None:
    from camcal.report.rig import transform_lines

    for line in transform_lines(moved.transform, None, verbose=verbose):
        show.text(line)
    also = [word for word, has in (("normals", moved.normals), ("covariances", moved.covariances)) if has]
    show.text(f"{moved.count} points{' with ' + ' and '.join(also) if also else ''}")
    show.wrote(moved.output)


def _wrote(output: Output) -> None:
    if output.numbers is None:
        show.wrote(output.path)
