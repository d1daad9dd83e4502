"""`camcal pnp`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.arrays import Array
    from camcal.estimate.pnp import PoseEstimate
    from camcal.tasks.pnp import PnpReport

LISTED = 10


def pnp(
    camera_file: Annotated[str, typer.Argument(metavar="CAMERA", help="Camera file, or FILE#NAME.")],
    inputs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="IMAGES…|DETECTIONS", help="Images of the board, folders, globs; or one detections file."
        ),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="Correspondences: X,Y,Z (metres), u,v (pixels), optionally image, id, suu,suv,svv."
        ),
    ] = None,
    board: shared.BoardOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PATH", help="Where to write the poses: .yaml, .json or .csv."),
    ] = None,
    inverse: Annotated[
        bool, typer.Option("--inverse", help="Give object_T_camera, the camera's place, not camera_T_object.")
    ] = False,
    noise: Annotated[
        float | None,
        typer.Option(
            metavar="PX",
            help="Standard deviation of a pixel coordinate (with suu,suv,svv: their factor's root); "
            "by default from the residuals of all images.",
        ),
    ] = None,
    camera: shared.CameraName = None,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Find the pose of an object from known points and their pixels, or of a board from images of it.

    camera_T_object takes points of the object to the camera (x right, y down, z forward). Every pose comes with its
    covariance and, where another pose fits nearly as well, with that pose and its probability.
    """
    from camcal.errors import ItemsFailed, NotConverged
    from camcal.tasks.pnp import PnpOptions, document
    from camcal.tasks.pnp import pnp as run

    report = run(
        PnpOptions(camera_file, points, board, tuple(inputs or ()), output, inverse, noise, camera, recursive, jobs),
        show.progress(quiet),
    )
    if json:
        show.document("pnp", document(report))
    elif not quiet:
        _show(report, output, verbose)
    if report.unsettled:
        raise NotConverged(f"these poses did not converge: {', '.join(report.unsettled[:LISTED])}")
    if failed := report.failed:
        total = len(failed) + len(report.poses.estimates)
        raise ItemsFailed(f"{len(failed)} of {total} images have no pose: {', '.join(failed[:LISTED])}")


def _show(report: "PnpReport", output: Path | None, verbose: bool) -> None:
    for note in report.notes:
        show.text(note)
    estimates, unit = report.poses.estimates, report.poses.unit
    listed = list(estimates.items())[: None if verbose else LISTED]
    columns = ["image", "points", "RMS px", f"x y z, {'mm' if unit == 'm' else unit}", "± std"]
    columns += ["rotation vector, deg", "± std", "status"]
    show.table(report.poses.frames, columns, [_row(image, estimate, unit) for image, estimate in listed])
    if len(listed) < len(estimates):
        show.text(f"… and {len(estimates) - len(listed)} more (--verbose lists all)")
    noise = listed[0][1]
    source = "as given" if noise.freedom is None else f"from the residuals, {noise.freedom} degrees of freedom"
    show.text(f"noise {noise.sigma_px:.3g} px, {source}")
    for image, reason in report.poses.missing.items():
        show.text(f"no pose: {image}: {reason}")
    if output:
        show.text(f"wrote {output}")


def _row(image: str, estimate: "PoseEstimate", unit: str) -> list[object]:
    import numpy as np

    scale = 1000 if unit == "m" else 1
    std = np.sqrt(np.diag(estimate.covariance))
    place = _numbers(scale * estimate.transform.translation, ".3f"), _numbers(scale * std[:3], ".2g")
    turn = _numbers(np.degrees(estimate.transform.vector()), ".3f"), _numbers(np.degrees(std[3:]), ".2g")
    return [image, estimate.used, estimate.rms_px, *place, *turn, estimate.status]


def _numbers(values: "Array", form: str) -> str:
    return " ".join(format(value, form) for value in values)
