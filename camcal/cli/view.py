"""`camcal view`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.stereo.view import ViewReport


def view(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CLOUD|DISPARITY",
            help="Point cloud (PLY, PCD, XYZ, NPZ, GLB, LAS, LAZ), or disparity map with its sidecar.",
        ),
    ],
    image: Annotated[
        Path | None,
        typer.Argument(metavar="IMAGE", help="Left image for the colours of a map; by default the sidecar's."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="A page (.html), a picture (.png), a film (.gif, .mp4) or a recording for Rerun (.rrd).",
        ),
    ] = None,
    frame: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|WORDS",
            help="Where the axes of a cloud point: optical, camera, ros, opengl, enu, or words such as "
            "'x forward, y left, z up'; by default what its file says.",
        ),
    ] = None,
    colour: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="image, depth, sigma or gray; by default image, or depth where there is none."
        ),
    ] = None,
    view: Annotated[
        str,
        typer.Option(
            metavar="VIEW",
            help="camera, front, top, side, or AZ,EL[,DIST]: degrees to the right and up, and the distance.",
        ),
    ] = "camera",
    montage: Annotated[bool, typer.Option("--montage", help="Four views in one picture.")] = False,
    size: Annotated[
        str | None,
        typer.Option(metavar="WxH", help="Pixels of a picture or film; by default 1280 or 640 wide, as high as fits."),
    ] = None,
    point_size: Annotated[
        float, typer.Option(metavar="FACTOR", help="Size of the points; 1 closes the surfaces.")
    ] = 1.0,
    max_points: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=1,
            help="Most points shown, taken evenly; by default 400000 in a page, 1000000 in a film, else 4000000.",
        ),
    ] = None,
    turn: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            help="Angle of a film: 360 once round, less to and fro; by default 50 before what a camera saw, else 360.",
        ),
    ] = None,
    frames: Annotated[int, typer.Option(metavar="N", min=2, help="Frames of a film, 20 a second.")] = 60,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="Open the Rerun viewer, or with -o write for it; needs camcal[view].")
    ] = False,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Look at a point cloud or a disparity map: a page that turns and measures, a picture, or a film.

    A page is one file that opens offline in any browser: drag to turn, wheel or pinch to zoom, click two points to
    measure. Pictures and films need no screen. A map without a geometry beside it is shown as it is, as a .png.
    """
    from camcal.tasks.stereo.view import ViewOptions, document
    from camcal.tasks.stereo.view import view as run

    options = ViewOptions(
        source,
        output,
        image,
        frame,
        colour,
        view,
        montage,
        None if size is None else shared.parse_size(size),
        point_size,
        max_points,
        turn,
        frames,
        rerun,
    )
    report = run(options, show.progress(quiet))
    if json:
        show.document("view", document(report))
    elif not quiet:
        _show(report)


def _show(report: "ViewReport") -> None:
    if report.points:
        shown = report.shown + report.outside
        points = f"{report.points} points" if shown == report.points else f"{shown} of {report.points} points"
        outside = f" ({report.outside} far outside left out)" if report.outside else ""
        show.text(f"{points}{outside} in {report.unit}, coloured by {report.colour}; {report.frame}")
    show.text(f"wrote {report.output}" if report.output else "opened the Rerun viewer")
