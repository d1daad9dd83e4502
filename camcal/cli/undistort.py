"""`camcal undistort`."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show
from camcal.errors import InvalidInput
from camcal.parsing import parse_numbers

if TYPE_CHECKING:
    from camcal.tasks.calibration.undistort import UndistortOptions, UndistortReport
    from camcal.tasks.calibration.undistort_points import PointsOptions

LISTED = 10


def undistort(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A camera file, or FILE#NAME for one of several.")],
    output: shared.Output,
    inputs: Annotated[
        list[str] | None, typer.Argument(metavar="IMAGES…", help="Images, videos, folders, globs.")
    ] = None,
    alpha: Annotated[
        float | None,
        typer.Option(metavar="0…1", help="From 0, crop all black (the default), to 1, keep all pixels of the image."),
    ] = None,
    keep_k: Annotated[
        bool, typer.Option("--keep-k", help="Keep focal lengths and principal point, whatever that shows.")
    ] = False,
    stretch: Annotated[
        bool, typer.Option("--stretch", help="Let pixels be oblong where that shows more, as OpenCV does.")
    ] = False,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Size of the new images; by default that of the camera.")
    ] = None,
    projection: Annotated[
        str,
        typer.Option(
            metavar="NAME", help="pinhole; for lenses of 180° and more cylinder, equirectangular, stereographic."
        ),
    ] = "pinhole",
    fov: Annotated[
        float | None,
        typer.Option(metavar="DEGREES", help="Field of view across the width; by default what the lens sees."),
    ] = None,
    interpolation: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="nearest-truncate (as textbooks print it), nearest (rounded), linear, cubic, lanczos. "
            "Linear places the image best: cubic and lanczos are off by up to 0.06 and 0.03 px in OpenCV.",
        ),
    ] = "linear",
    border: Annotated[
        str, typer.Option(metavar="VALUE", help="Pixels without a source: a number, or one for each channel: B,G,R.")
    ] = "0",
    mask: Annotated[
        bool, typer.Option("--mask", help="Write valid_mask.png too: 255 where a pixel has a source.")
    ] = False,
    image_format: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="jpg, png, tiff or npy; by default as the image (video: jpg)."),
    ] = None,
    quality: Annotated[int, typer.Option(metavar="1…100", help="Of JPEG.")] = 95,
    rescale: Annotated[
        bool, typer.Option("--rescale", help="Fit the camera to images that were resized (not cropped).")
    ] = False,
    align_channels: Annotated[
        bool,
        typer.Option(
            help="Draw red and blue of colour images through their own lenses, if the camera file has channels "
            "('camcal calibrate --channels'), so that the colours coincide."
        ),
    ] = True,
    points: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Undistort pixels, not images: columns u, v and any others, which are kept."),
    ] = None,
    distort: Annotated[
        bool, typer.Option("--distort", help="With --points: from the undistorted image back to the camera's.")
    ] = False,
    camera_name: shared.CameraName = None,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Undistort images, videos or points, and write the camera file that fits what comes out.

    Images keep their type, depth and EXIF orientation; frames of a video become images. camera.yaml beside them is the
    camera to go on with.
    """
    from camcal.images.views import ViewOptions
    from camcal.tasks.calibration.undistort import UndistortOptions
    from camcal.tasks.calibration.undistort_points import PointsOptions

    view = ViewOptions(alpha, keep_k, _size(size), projection, fov, stretch)
    if points is not None:
        if inputs:
            raise InvalidInput(f"--points takes no images, found {inputs[0]}")
        _undistort_points(PointsOptions(camera, points, output, camera_name, view, distort), json, quiet)
        return
    if distort:
        raise InvalidInput("--distort is for --points")
    options = UndistortOptions(
        camera=camera,
        inputs=tuple(inputs or ()),
        output=output,
        camera_name=camera_name,
        view=view,
        interpolation=interpolation,
        border=_border(border),
        mask=mask,
        format=image_format,
        quality=quality,
        rescale=rescale,
        align_channels=align_channels,
        recursive=recursive,
        jobs=jobs,
    )
    _undistort_images(options, json, quiet, verbose)


def _undistort_images(options: "UndistortOptions", json: bool, quiet: bool, verbose: bool) -> None:
    from camcal.errors import ItemsFailed
    from camcal.tasks.calibration.undistort import document
    from camcal.tasks.calibration.undistort import undistort as run

    report = run(options, show.progress(quiet))
    if json:
        show.document("undistort", document(report))
    elif not quiet:
        _show(report, verbose)
    if report.failed:
        raise ItemsFailed(f"{len(report.failed)} of {len(report.outcomes)} images failed, the rest is written")


def _undistort_points(options: "PointsOptions", json: bool, quiet: bool) -> None:
    from camcal.tasks.calibration.undistort_points import document
    from camcal.tasks.calibration.undistort_points import undistort_points as run

    report = run(options, show.progress(quiet))
    if json:
        show.document("undistort", document(report))
    elif not quiet:
        lost = f", {report.lost} without a place (empty cells)" if report.lost else ""
        show.text(f"{report.output}: {report.count} points{lost}")
        if report.camera_file is not None:
            show.text(f"{report.camera_file}: the camera these pixels belong to")


def _show(report: "UndistortReport", verbose: bool) -> None:
    written = [outcome.value.output for outcome in report.outcomes if outcome.value is not None]
    for path in written if verbose else written[:LISTED]:
        show.text(f"{path}")
    if not verbose and len(written) > LISTED:
        show.text(f"… and {len(written) - LISTED} more (--verbose lists all)")
    for outcome in report.failed:
        show.text(f"failed: {outcome.error}")
    if report.aligned:
        show.text(f"{' and '.join(report.aligned)} of colour images are drawn through lenses of their own")
    width, height = report.view.image_size
    focal = " ".join(f"{name}={report.view.value(name):.6g}" for name in ("fx", "fy", "cx", "cy"))
    empty = f"; {100 * (1 - report.valid):.1f} % of its pixels have no source" if report.valid < 1 else ""
    show.text(f"{report.camera_file}: {report.view.model.name}, {width}x{height}, {focal}{empty}")


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"([0-9]{1,6})x([0-9]{1,6})", text)
    if match is None:
        raise InvalidInput(f"size {text!r} is not understood; write 1920x1080", where="--size")
    return int(match[1]), int(match[2])


def _border(text: str) -> tuple[float, ...]:
    try:
        return tuple(parse_numbers(text.split(",")))
    except ValueError:
        raise InvalidInput(f"border {text!r} is not understood; write 0, or 255,0,0", where="--border") from None
