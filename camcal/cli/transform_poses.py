"""`camcal transform convert`, `average`, `check` and `points`."""

from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import Call
from camcal.tasks.frames.options import AverageOptions, CheckOptions, ConvertOptions, Output, PointsOptions

if TYPE_CHECKING:
    from camcal.tasks.frames.transform_average import Averaged
    from camcal.tasks.frames.transform_check import Checked
    from camcal.tasks.frames.transform_convert import Converted
    from camcal.tasks.frames.transform_points import MovedPoints

LISTED = 10


def convert(options: ConvertOptions, call: Call) -> None:
    """Write poses in another form, or along the axes of another program.

    Unity is left-handed: there the axes of both frames change, or no rotation is left.
    """
    from camcal.tasks.frames.transform_convert import convert as run
    from camcal.tasks.frames.transform_convert import document

    if options.output.trajectory:
        _convert_trajectory(options, call)
        return
    converted = run(options, call.progress)
    where = options.output
    call.give(lambda: document(converted, where), lambda: _show_converted(converted, where, verbose=call.verbose))


def _show_converted(converted: "Converted", output: Output, *, verbose: bool) -> None:
    from camcal.report.transform import lines

    for transform in converted.transforms:
        for line in lines(transform, output.numbers, verbose=verbose):
            show.text(line)
    _wrote(output)


def _convert_trajectory(options: ConvertOptions, call: Call) -> None:
    from camcal.tasks.frames.transform_trajectory import convert_trajectory, document

    converted = convert_trajectory(options, call.progress)
    count, frames = len(converted.trajectory), converted.trajectory.frames
    call.give(lambda: document(converted), lambda: show.text(f"{count} poses {frames}\nwrote {converted.output}"))


def average(options: AverageOptions, call: Call) -> None:
    """Average several estimates of one pose: by their covariances if all have one, alike otherwise.

    The mean of rotations is Karcher's: the one from which the squared angles add up to the least.
    """
    from camcal.tasks.frames.transform_average import average as run
    from camcal.tasks.frames.transform_average import document

    averaged = run(options, call.progress)
    where = options.output
    call.give(lambda: document(averaged, where), lambda: _show_average(averaged, where, verbose=call.verbose))


def _show_average(averaged: "Averaged", output: Output, *, verbose: bool) -> None:
    from camcal.report.transform import average_line, estimate_rows, lines

    for line in lines(averaged.transform, output.numbers, verbose=verbose):
        show.text(line)
    if output.numbers is None:
        show.text(average_line(averaged.mean, weighted=averaged.weighted))
        rows = estimate_rows(averaged.estimates, averaged.mean)
        show.table("estimates", ["pose", "weight", "mm off", "deg off"], rows if verbose else rows[:LISTED])
        if not verbose and len(rows) > LISTED:
            show.text(f"… and {len(rows) - LISTED} more (--verbose lists all)")
    _wrote(output)


def check(options: CheckOptions, call: Call) -> None:
    """Say whether poses are any: orthonormality, determinant, the length of quaternions. Exit with 7 if one is none.

    A determinant of -1 is a reflection, of a flipped axis or a left-handed frame, and is never mended.
    """
    from camcal.tasks.frames.transform_check import check as run
    from camcal.tasks.frames.transform_check import document, require_good

    checked = run(options, call.progress)
    where = options.output
    call.give(lambda: document(checked, where), lambda: _show_check(checked, where, verbose=call.verbose))
    require_good(checked, fix=options.fix)


def _show_check(checked: "Checked", output: Output, *, verbose: bool) -> None:
    from camcal.report.transform import lines

    if output.numbers is None:
        columns = ["pose", "verdict", "|R Rᵀ - I|", "det R", "deg to a rotation", "|q|"]
        show.table("checked", columns, [pose.row for pose in checked.poses])
    for transform in checked.fixed:
        for line in lines(transform, output.numbers, verbose=verbose):
            show.text(line)
    if checked.fixed:
        _wrote(output)


def points(options: PointsOptions, call: Call) -> None:
    """Take the points of a file to another frame; normals turn along, and covariances too.

    In a CSV the uncertainty of the transform is added to that of every point. It is the same for all of them: it does
    not average out.
    """
    from camcal.tasks.frames.transform_points import document, transform_points

    moved = transform_points(options, call.progress)
    call.give(lambda: document(moved), lambda: _show_points(moved, verbose=call.verbose))


def _show_points(moved: "MovedPoints", *, verbose: bool) -> None:
    from camcal.report.transform import lines

    for line in lines(moved.transform, None, verbose=verbose):
        show.text(line)
    also = [word for word, has in (("normals", moved.normals), ("covariances", moved.covariances)) if has]
    show.text(f"{moved.count} points{' with ' + ' and '.join(also) if also else ''}")
    show.text(f"wrote {moved.output}")


def _wrote(output: Output) -> None:
    if output.path is not None and output.numbers is None:
        show.text(f"wrote {output.path}")
