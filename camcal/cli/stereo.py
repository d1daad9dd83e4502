"""`camcal stereo …`: what two cameras measure."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.cloud import CloudReport


def cloud(
    disparity: Annotated[
        Path, typer.Argument(metavar="DISPARITY", help="Disparity map of the left image: PNG, TIFF, PFM or NPY.")
    ],
    output: shared.Output,
    image: Annotated[str | None, typer.Argument(metavar="IMAGE", help="The rectified left image, for colour.")] = None,
    camera_file: Annotated[
        str | None, typer.Argument(metavar="CAMERA", help="Camera file of the rectified pair, or FILE#NAME.")
    ] = None,
    camera: shared.CameraName = None,
    fx: Annotated[float | None, typer.Option(metavar="PIXELS", help="Focal length.")] = None,
    fy: Annotated[float | None, typer.Option(metavar="PIXELS", help="Focal length along y; by default fx.")] = None,
    cx: Annotated[float | None, typer.Option(metavar="PIXELS", help="Principal point of the left image, x.")] = None,
    cy: Annotated[float | None, typer.Option(metavar="PIXELS", help="Principal point, y.")] = None,
    baseline: Annotated[float | None, typer.Option(metavar="METRES", help="Distance of the cameras.")] = None,
    doffs: Annotated[
        float | None, typer.Option(metavar="PIXELS", help="cx of the right image minus cx of the left; by default 0.")
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(metavar="COUNTS", help="Counts per pixel of disparity; by default 256 for 16-bit maps, else 1."),
    ] = None,
    min_depth: Annotated[float, typer.Option(metavar="METRES", help="Leave out what is nearer.")] = 0.0,
    max_depth: Annotated[float, typer.Option(metavar="METRES", help="Leave out what is farther.")] = float("inf"),
    ascii_text: Annotated[bool, typer.Option("--ascii", help="Write PLY as text.")] = False,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Make a point cloud (.ply or .xyz, metres) from a disparity map: z = f b / (d + doffs).

    The frame is the left camera's: x right, y down, z forward. Pixels without a match (zero, negative, NaN, infinite)
    never become points. Gray images give a colour and an intensity from 0 to 1.
    """
    from camcal.tasks.cloud import CloudOptions, document, stereo_cloud

    report = stereo_cloud(
        CloudOptions(
            disparity,
            output,
            tuple(text for text in (image, camera_file) if text is not None),
            camera,
            fx,
            fy,
            cx,
            cy,
            baseline,
            doffs,
            scale,
            min_depth,
            max_depth,
            ascii_text,
        ),
        show.progress(quiet),
    )
    if json:
        show.document("stereo cloud", document(report))
    elif not quiet:
        _show_cloud(report)


def _show_cloud(report: "CloudReport") -> None:
    geometry = report.geometry
    show.text(f"disparity = count / {report.scale:g}, {report.points} of {report.pixels} pixels have a point")
    show.text(f"fx {geometry.fx:g} px, baseline {geometry.baseline:g} m, doffs {geometry.doffs:g} px")
    if report.depth is not None:
        nearest, median, farthest = report.depth
        show.text(f"depth {nearest:.3f} … {farthest:.3f} m, median {median:.3f} m")
    show.text(f"wrote {report.output}")
