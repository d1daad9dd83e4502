"""`camcal transform convert`, `average`, `check` and `points`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show
from camcal.cli import transform_options as poses

if TYPE_CHECKING:
    from camcal.tasks.frames.transform_average import Averaged
    from camcal.tasks.frames.transform_check import Checked
    from camcal.tasks.frames.transform_convert import ConvertOptions
    from camcal.tasks.frames.transform_output import Output

LISTED = 10


def convert(
    sources: poses.Poses,
    axes: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FRAME=FROM:TO",
            help="Let the axes of a frame point elsewhere, as camera=opencv:opengl (frames without names are a and b); "
            "may be given for each: opencv, colmap, ros_optical, opengl, blender, nerf, unity, ros, enu, ned.",
        ),
    ] = None,
    inverse: Annotated[bool, typer.Option("--inverse", help="Invert the poses first: b_T_a for a_T_b.")] = False,
    trajectory: Annotated[
        bool,
        typer.Option(
            "--trajectory", help="POSE is a trajectory file, written to --output by its suffix or as tum, kitti, ros."
        ),
    ] = False,
    form: poses.Given = None,
    written: poses.As = None,
    output: poses.OutputFile = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Write poses in another form, or along the axes of another program.

    Unity is left-handed: there the axes of both frames change, or no rotation is left.
    """
    from camcal.report.transform import lines
    from camcal.tasks.frames.transform_convert import ConvertOptions, document
    from camcal.tasks.frames.transform_convert import convert as run
    from camcal.tasks.frames.transform_output import Output

    where = Output(output, written, trajectory)
    options = ConvertOptions(sources, tuple(axes or ()), form, inverse, where)
    if trajectory:
        _convert_trajectory(options, json=json, quiet=quiet)
        return
    converted = run(options, show.progress(quiet))
    if json:
        show.document("transform convert", document(converted, where))
    elif not quiet:
        for transform in converted.transforms:
            for line in lines(transform, where.numbers, verbose=verbose):
                show.text(line)
        _wrote(where)


def _convert_trajectory(options: "ConvertOptions", *, json: bool, quiet: bool) -> None:
    from camcal.tasks.frames.transform_trajectory import convert_trajectory, document

    converted = convert_trajectory(options, show.progress(quiet))
    if json:
        show.document("transform convert", document(converted))
    elif not quiet:
        show.text(f"{len(converted.trajectory)} poses {converted.trajectory.frames}")
        show.text(f"wrote {converted.output}")


def average(
    sources: poses.Poses,
    robust: Annotated[bool, typer.Option("--robust", help="Let poses far from the others count little.")] = False,
    equal: Annotated[bool, typer.Option("--equal", help="Let all count alike, whatever their covariances.")] = False,
    trajectory: Annotated[
        bool,
        typer.Option("--trajectory", help="POSE are trajectory files: average all their poses, of what stood still."),
    ] = False,
    form: poses.Given = None,
    written: poses.As = None,
    output: poses.OutputFile = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Average several estimates of one pose: by their covariances if all have one, alike otherwise.

    The mean of rotations is Karcher's: the one from which the squared angles add up to the least.
    """
    from camcal.tasks.frames.transform_average import AverageOptions, document
    from camcal.tasks.frames.transform_average import average as run
    from camcal.tasks.frames.transform_output import Output

    where = Output(output, written)
    options = AverageOptions(sources, form, robust, equal, trajectory, where)
    averaged = run(options, show.progress(quiet))
    if json:
        show.document("transform average", document(averaged, where))
    elif not quiet:
        _show_average(averaged, where, verbose=verbose)


def _show_average(averaged: "Averaged", output: "Output", *, verbose: bool) -> None:
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


def check(
    sources: poses.Poses,
    fix: Annotated[
        bool, typer.Option("--fix", help="Give the nearest poses, also to --output; reflections have none.")
    ] = False,
    form: poses.Given = None,
    written: poses.As = None,
    output: poses.OutputFile = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Say whether poses are any: orthonormality, determinant, the length of quaternions. Exit with 7 if one is none.

    A determinant of -1 is a reflection, of a flipped axis or a left-handed frame, and is never mended.
    """
    from camcal.tasks.frames.transform_check import CheckOptions, document, require_good
    from camcal.tasks.frames.transform_check import check as run
    from camcal.tasks.frames.transform_output import Output

    where = Output(output, written)
    checked = run(CheckOptions(sources, form, fix, where), show.progress(quiet))
    if json:
        show.document("transform check", document(checked, where))
    elif not quiet:
        _show_check(checked, where, verbose=verbose)
    require_good(checked, fix=fix)


def _show_check(checked: "Checked", output: "Output", *, verbose: bool) -> None:
    from camcal.report.transform import lines

    if output.numbers is None:
        columns = ["pose", "verdict", "|R Rᵀ - I|", "det R", "deg to a rotation", "|q|"]
        show.table("checked", columns, [pose.row for pose in checked.poses])
    for transform in checked.fixed:
        for line in lines(transform, output.numbers, verbose=verbose):
            show.text(line)
    if checked.fixed:
        _wrote(output)


def points(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A CSV with columns x,y,z, also nx,ny,nz and sxx,sxy,sxz,syy,syz,szz; or a cloud: PLY, PCD, XYZ, "
            "NPZ, GLB, LAS, LAZ.",
        ),
    ],
    transform: Annotated[
        str,
        typer.Option("--with", metavar="POSE", help="a_T_b, where the points are in b: numbers, a file or FILE#NAME."),
    ],
    output: shared.Output,
    inverse: Annotated[bool, typer.Option("--inverse", help="The points are in a and go to b.")] = False,
    unit: Annotated[str, typer.Option(metavar="m|mm", help="Unit of a CSV's points; clouds say theirs.")] = "m",
    form: poses.Given = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Take the points of a file to another frame; normals turn along, and covariances too.

    In a CSV the uncertainty of the transform is added to that of every point. It is the same for all of them: it does
    not average out.
    """
    from camcal.report.transform import lines
    from camcal.tasks.frames.transform_points import PointsOptions, document, transform_points

    moved = transform_points(PointsOptions(file, transform, output, inverse, form, unit), show.progress(quiet))
    if json:
        show.document("transform points", document(moved))
    elif not quiet:
        for line in lines(moved.transform, None, verbose=verbose):
            show.text(line)
        also = [word for word, has in (("normals", moved.normals), ("covariances", moved.covariances)) if has]
        show.text(f"{moved.count} points{' with ' + ' and '.join(also) if also else ''}")
        show.text(f"wrote {moved.output}")


def _wrote(output: "Output") -> None:
    if output.path is not None and output.numbers is None:
        show.text(f"wrote {output.path}")
