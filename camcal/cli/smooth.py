"""`camcal smooth`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.poses.smooth_options import Smoothing


def smooth(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="Poses over time (.tum, .csv, .yaml, .json, KITTI, EuRoC), or a CSV of other numbers over time.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="PATH", help="Smoothed poses (.tum .csv .yaml .json), or numbers (.csv .json)."
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(metavar="T,X[,Y…]", help="Columns of a CSV: the time, then what to smooth; by default all."),
    ] = None,
    model: Annotated[
        str, typer.Option(metavar="rw|cv|ca", help="Random walk, constant velocity, constant acceleration.")
    ] = "cv",
    process_noise_form: Annotated[
        str,
        typer.Option(metavar="continuous|discrete", help="White noise over time, or the textbooks' one per step."),
    ] = "continuous",
    q: Annotated[
        str,
        typer.Option("--q", metavar="NUMBER|auto", help="Strength of the process noise; of poses two: 0.02,0.5."),
    ] = "auto",
    sigma: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER[,…]",
            help="Standard deviation of the measurements, of poses two (m,rad); "
            "by default what the file has, else estimated.",
        ),
    ] = None,
    method: Annotated[
        str, typer.Option(metavar="rts|batch", help="Filter and smoother, or all at once; the result is the same.")
    ] = "rts",
    robust: Annotated[
        str, typer.Option(metavar="none|huber", help="Let measurements that do not fit lose weight.")
    ] = "none",
    controls: Annotated[
        Path | None,
        typer.Option("--input", metavar="FILE", help="A CSV of known displacements: the time, then a column for each."),
    ] = None,
    resample: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Write states so far apart, between measurements too.")
    ] = None,
    evaluate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Compare the poses with these: absolute and relative error.")
    ] = None,
    align: Annotated[
        str, typer.Option(metavar="none|se3|sim3|yaw", help="What is fitted to the reference before comparing.")
    ] = "se3",
    delta: Annotated[
        str, typer.Option(metavar="NUMBER[m|s]", help="Relative errors over so many frames, metres or seconds.")
    ] = "1",
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="A figure over time: .png, .svg or .pdf.")] = None,
    frames: Annotated[
        str | None, typer.Option(metavar="A_T_B", help="What the poses are, where the file does not say.")
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="tum, csv, yaml, json, kitti or tf; by default by the suffix."),
    ] = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Smooth what was measured over time, and say how well it is known.

    Noise is estimated where it is not given. The result has covariances; what does not fit is listed, and the filter's
    innovations say whether the covariances can be believed.
    """
    from camcal.estimate.trajectory_error import ErrorOptions
    from camcal.tasks.poses.smooth import document
    from camcal.tasks.poses.smooth import smooth as smooth_file
    from camcal.tasks.poses.smooth_options import SmoothOptions

    found = smooth_file(
        SmoothOptions(
            source,
            output,
            () if columns is None else tuple(name.strip() for name in columns.split(",")),
            model,
            process_noise_form,
            None if q == "auto" else shared.parse_numbers("--q", q),
            None if sigma is None else shared.parse_numbers("--sigma", sigma),
            method,
            robust,
            controls,
            resample,
            evaluate,
            ErrorOptions(align, *_parse_delta(delta)),
            plot,
            frames,
            kind,
        ),
        show.progress(quiet),
    )
    if json:
        show.document("smooth", document(found))
    elif not quiet:
        _show(found, verbose)


def _parse_delta(text: str) -> tuple[float, str]:
    """Return a number and its unit: frames, m or s."""
    unit = text[-1:] if text[-1:] in {"m", "s"} else "frames"
    return shared.parse_numbers("--delta", text.removesuffix(unit))[0], unit


def _show(found: "Smoothing", verbose: bool) -> None:
    from camcal.tasks.poses.smooth_words import evaluation_rows, lines, outlier_line

    for line in lines(found):
        show.text(line)
    if found.outliers:
        show.text(outlier_line(found, verbose))
    if found.before is not None and found.after is not None:
        show.table(*evaluation_rows(found.options.comparison, found.before, found.after))
    for path in found.written:
        show.text(f"wrote {path}")
