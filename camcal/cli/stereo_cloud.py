"""`camcal stereo cloud`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.stereo.cloud import CloudOptions, CloudReport

COMMAND = "stereo cloud"
LISTED = 10


def cloud(
    disparity: Annotated[
        Path,
        typer.Argument(
            metavar="DISPARITY", help="Disparity map of the left image: PFM, TIFF, PNG, NPY, NPZ, EXR; or a folder."
        ),
    ],
    output: shared.Output,
    image: Annotated[str | None, typer.Argument(metavar="IMAGE", help="The rectified left image, for colour.")] = None,
    camera_file: shared.PairCamera = None,
    camera: shared.CameraName = None,
    fx: shared.Fx = None,
    fy: shared.Fy = None,
    cx: shared.Cx = None,
    cy: shared.Cy = None,
    baseline: shared.Baseline = None,
    doffs: shared.Doffs = None,
    scale: Annotated[
        float | None,
        typer.Option(
            metavar="COUNTS",
            help="Counts per pixel of disparity; by default the sidecar's, or 256 for 16-bit (signed: 16), else 1.",
        ),
    ] = None,
    frame: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="optical (x right, y down, z forward), camera (before rectification, where the sidecar holds the "
            "rotation), ros, opengl, enu (with --pose).",
        ),
    ] = "optical",
    unit: Annotated[str, typer.Option(metavar="m|mm", help="Unit of the coordinates.")] = "m",
    pose: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="world_T_camera, 4 x 4 numbers or a TUM line: gives points in the world."),
    ] = None,
    min_depth: Annotated[float, typer.Option(metavar="METRES", help="Leave out what is nearer.")] = 0.0,
    max_depth: Annotated[float, typer.Option(metavar="METRES", help="Leave out what is farther.")] = float("inf"),
    crop: Annotated[
        str | None,
        typer.Option(metavar="BOX", help="Keep what is within xmin,xmax,ymin,ymax,zmin,zmax: metres, in the frame."),
    ] = None,
    mask: Annotated[Path | None, typer.Option(metavar="IMAGE", help="Keep pixels where it is not zero.")] = None,
    max_sigma: Annotated[
        float | None,
        typer.Option(metavar="PERCENT", help="Leave out depths whose standard deviation is a larger part of them."),
    ] = None,
    min_confidence: Annotated[
        str | None,
        typer.Option(
            metavar="CLASS", help="Leave out less sure pixels: filled, single, apart, near, agreed; or 1 to 5."
        ),
    ] = None,
    stride: Annotated[int, typer.Option(metavar="N", help="Every N-th pixel of every N-th row.")] = 1,
    outliers: Annotated[
        str,
        typer.Option(
            metavar="METHOD",
            help="organised (fewer than 6 of 24 neighbours within 1 px), radius:METRES (fewer than 6 points), or none.",
        ),
    ] = "organised",
    voxel: Annotated[
        float | None, typer.Option(metavar="METRES", help="One point, the mean, for every cube of this side.")
    ] = None,
    max_points: Annotated[
        int | None, typer.Option(metavar="N", help="At most so many points, drawn at random.")
    ] = None,
    normals: Annotated[bool, typer.Option("--normals", help="Write the normals of surfaces.")] = False,
    sigma: Annotated[bool, typer.Option("--sigma", help="Write the standard deviation of the depth.")] = False,
    sigma_disparity: Annotated[
        float | None,
        typer.Option(
            metavar="PIXELS", help="Standard deviation of the disparity; by default the image the sidecar names."
        ),
    ] = None,
    organised: Annotated[
        bool, typer.Option("--organised", help="Write a place for every pixel, NaN where there is no point (.pcd).")
    ] = False,
    ascii_text: Annotated[bool, typer.Option("--ascii", help="Write PLY or PCD as text.")] = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Make a point cloud from a disparity map: z = f b / (d + doffs).

    What is not given is taken from the file that 'camcal stereo disparity' writes beside a map. Pixels without a match
    (zero, negative, NaN, infinite) never become points. Gray images give a colour and an intensity from 0 to 1.
    """
    from camcal.tasks.stereo.cloud import CloudOptions, PointOptions, VertexOptions
    from camcal.tasks.stereo.rectified_pair import GeometryOptions

    options = CloudOptions(
        disparity,
        output,
        tuple(text for text in (image, camera_file) if text is not None),
        GeometryOptions(camera, fx, fy, cx, cy, baseline, doffs),
        scale,
        PointOptions(
            (min_depth, max_depth),
            None if crop is None else shared.parse_numbers("--crop", crop),
            mask,
            max_sigma,
            min_confidence,
            sigma_disparity,
            stride,
            outliers,
            voxel,
            max_points,
        ),
        VertexOptions(frame, unit, pose, normals, sigma, organised, ascii_text),
        jobs,
    )
    if disparity.is_dir():
        _make_clouds(options, json, quiet, verbose)
    else:
        _make_cloud(options, json, quiet)


def _make_cloud(options: "CloudOptions", json: bool, quiet: bool) -> None:
    from camcal.tasks.stereo.cloud import document, stereo_cloud

    report = stereo_cloud(options, show.progress(quiet))
    if json:
        show.document(COMMAND, document(report))
    elif not quiet:
        _show_cloud(report)


def _make_clouds(options: "CloudOptions", json: bool, quiet: bool, verbose: bool) -> None:
    from camcal.progress import require_all
    from camcal.tasks.stereo.cloud_folder import cloud_folder, document

    outcomes = cloud_folder(options, show.progress(quiet))
    if json:
        show.document(COMMAND, document(outcomes))
    elif not quiet:
        reports = [outcome.value for outcome in outcomes if outcome.value is not None]
        for report in reports if verbose else reports[:LISTED]:
            show.text(f"{report.output}: {report.points} points of {report.pixels} pixels")
        if len(reports) > LISTED and not verbose:
            show.text(f"… and {len(reports) - LISTED} more (--verbose lists all)")
    require_all(outcomes, "maps")


def _show_cloud(report: "CloudReport") -> None:
    geometry = report.geometry
    show.text(
        f"disparity = count / {report.scale:g}, {report.points} points of {report.pixels} pixels "
        f"({report.matched} with a match, {report.outliers} of these alone)"
    )
    show.text(f"fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px")
    if report.depth is not None:
        nearest, median, farthest = report.depth
        show.text(f"depth {nearest:.3f} … {farthest:.3f} m, median {median:.3f} m")
    show.text(f"wrote {report.output}: {' '.join(report.fields)} in {report.unit}; {report.frame}")
