"""`camcal pnp`."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from camcal.cli import options as shared
from camcal.cli import show
from camcal.errors import InvalidInput
from camcal.parsing import parse_number

if TYPE_CHECKING:
    from camcal.tasks.poses.pnp import PnpReport
    from camcal.tasks.poses.pnp_prior import PriorOptions

LISTED = 10


def pnp(
    camera_file: Annotated[
        str | None, typer.Argument(metavar="CAMERA", help="Camera file, or FILE#NAME; left out with --rig.")
    ] = None,
    inputs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="IMAGES…|DETECTIONS",
            help="Images of a board or of tags, videos, folders, globs; or one detections file. With --rig NAME=IMAGES "
            "for each camera, such as left=photos/left right=photos/right.",
        ),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Correspondences as .csv, .yaml or .json: X,Y,Z (metres), u,v (pixels), optionally image, id, camera "
            "and sigma (px), suu,suv,svv (px²) or weight.",
        ),
    ] = None,
    board: shared.BoardOption = None,
    tags: Annotated[
        str | None,
        typer.Option(metavar="TAGS", help="A tag file, or a short form such as tag36h11:53mm or tag36h11:53mm:0,1,5."),
    ] = None,
    repeated_ids: Annotated[
        str,
        typer.Option(
            metavar="drop|keep",
            help="Tags of one id that an image shows more than once: none of them, or all, as tag_5, tag_5_2, … from "
            "top to bottom.",
        ),
    ] = "drop",
    rig: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Camera file with several cameras and transforms: one pose from what all of them see at an instant.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="PATH", help="Where to write the poses: .yaml, .json or .csv."),
    ] = None,
    draw: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Pictures of the axes, the projected points and enlarged residuals."),
    ] = None,
    pose: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="camera_T_object (the default) or object_T_camera, where the camera stands; of a rig the frame `rig` "
            "or its first camera in place of `camera`.",
        ),
    ] = None,
    outliers: Annotated[
        str,
        typer.Option(
            metavar="auto|none|few|many",
            help="none; few, rejected after a fit to all points; many, told apart by random samples. By default many "
            "for --points and few for boards and tags.",
        ),
    ] = "auto",
    threshold: Annotated[
        float | None,
        typer.Option(metavar="PX", help="Largest residual of an inlier; by default all that are more likely right."),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="PX|auto",
            help="Standard deviation of every pixel coordinate (of weight 1 where points have weights), in place of "
            "what detection, camera file or --points say of it; auto: from the residuals of all images.",
        ),
    ] = None,
    noise_scale: Annotated[
        str | None,
        typer.Option(
            metavar="FACTOR|auto",
            help="Factor on the standard deviations that pixels come with. By default 1 for sigma or suu,suv,svv of "
            "--points, for boards and tags auto: from the residuals of all images.",
        ),
    ] = None,
    prior: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="A pose that is known beforehand: a pose file with one pose, or a matrix as text."
        ),
    ] = None,
    prior_sigma: Annotated[
        str | None,
        typer.Option(metavar="METRES,DEGREES", help="How well --prior is known; by default as the pose file has it."),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the random samples.")] = 0,
    all_solutions: Annotated[
        bool, typer.Option("--all-solutions", help="List every pose that fits, not the likeliest two only.")
    ] = False,
    intrinsics: Annotated[
        bool, typer.Option(help="Let the covariance of the camera's parameters count in that of the poses.")
    ] = True,
    board_shape: Annotated[
        bool, typer.Option(help="Take a board in the shape that the camera file has of it, not as drawn.")
    ] = True,
    scale_intrinsics: Annotated[
        bool, typer.Option("--scale-intrinsics", help="Fit the camera to images that were resized (not cropped).")
    ] = False,
    max_rms: Annotated[
        float | None, typer.Option(metavar="PX", help="Exit with 7 if the residuals of a pose have a larger RMS.")
    ] = None,
    max_ambiguity: Annotated[
        float | None,
        typer.Option(metavar="P", help="Exit with 7 if a pose is wrong with a larger probability; try 0.01."),
    ] = None,
    min_inliers: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Exit with 7 if a pose follows from fewer points.")
    ] = None,
    camera: shared.CameraName = None,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Find the pose of an object from known points and their pixels, or of a board or of tags from images of them.

    camera_T_object takes points of the object to the camera (x right, y down, z forward). Every pose comes with its
    covariance and, where another pose fits nearly as well, with that pose and its probability.
    """
    from camcal.errors import ItemsFailed, NotConverged
    from camcal.tasks.poses.pnp import Gates, PnpOptions, document
    from camcal.tasks.poses.pnp import pnp as run
    from camcal.tasks.poses.pnp_views import Looking

    arguments = [text for text in (str(rig) if rig else None, camera_file) if text is not None] + (inputs or [])
    if not arguments:
        raise InvalidInput("which camera? Give a camera file, or --rig")
    gates = Gates(max_rms, max_ambiguity, min_inliers)
    options = PnpOptions(
        arguments[0],
        points,
        tuple(arguments[1:]),
        Looking(board, tags, board_shape, scale_intrinsics, recursive, jobs, repeated_ids),
        rig=rig is not None,
        output=output,
        draw=draw,
        name=camera,
        pose=pose,
        outliers=outliers,
        threshold_px=threshold,
        noise_px=_number("--noise", noise, "a number of pixels"),
        noise_scale=_number("--noise-scale", noise_scale, "a factor"),
        prior=_prior(prior, prior_sigma),
        seed=seed,
        all_solutions=all_solutions,
        intrinsics=intrinsics,
    )
    report = run(options, show.progress(quiet))
    if json:
        show.document("pnp", document(report))
    elif not quiet:
        _show(report, output, verbose=verbose, all_solutions=all_solutions)
    if report.unsettled:
        raise NotConverged(f"these poses did not converge: {', '.join(map(str, report.unsettled[:LISTED]))}")
    report.require_good(gates)
    if failed := report.failed:
        total = len(failed) + len(report.poses.estimates)
        raise ItemsFailed(f"{len(failed)} of {total} images have no pose: {', '.join(failed[:LISTED])}")


def _number(option: str, text: str | None, what: str) -> float | Literal["auto"] | None:
    if text is None or text == "auto":
        return "auto" if text else None
    try:
        return parse_number(text)
    except ValueError:
        raise InvalidInput(f"{option} {text!r}: {what}, or auto, is needed") from None


def _prior(path: Path | None, sigma: str | None) -> "PriorOptions | None":
    from camcal.tasks.poses.pnp_prior import PriorOptions

    if path is None:
        if sigma is not None:
            raise InvalidInput("--prior-sigma says how well --prior is known; give that too")
        return None
    if sigma is None:
        return PriorOptions(path)
    numbers = shared.parse_numbers("--prior-sigma", sigma)
    if len(numbers) != 2:
        raise InvalidInput(f"--prior-sigma {sigma!r}: METRES,DEGREES are needed, such as 0.05,2")
    return PriorOptions(path, (numbers[0], math.radians(numbers[1])))


def _show(report: "PnpReport", output: Path | None, *, verbose: bool, all_solutions: bool) -> None:
    from camcal.report import pose_words

    for note in report.notes:
        show.text(note)
    poses = report.poses
    listed = list(poses.estimates.items())[: None if verbose else LISTED]
    rows = [pose_words.row(poses, sight, record) for sight, record in listed]
    show.table(poses.frames, pose_words.columns(poses), rows)
    _show_more(len(poses.estimates) - len(listed))
    if all_solutions:
        _show_alternatives(report, verbose)
    show.text(pose_words.noise(poses))
    missing = list(poses.missing.items())[: None if verbose else LISTED]
    for sight, reason in missing:
        show.text(f"no pose: {sight}: {reason}")
    _show_more(len(poses.missing) - len(missing))
    if output:
        show.text(f"wrote {output}")
    if report.pictures:
        show.text(f"drew {len(report.pictures)} pictures in {report.pictures[0].parent}")


def _show_alternatives(report: "PnpReport", verbose: bool) -> None:
    from camcal.report import pose_words

    poses = report.poses
    rows = [row for item in poses.estimates.items() for row in pose_words.alternative_rows(poses, *item)]
    if not rows:
        show.text("no other pose fits")
        return
    heads = ["image", "x y z", "rotation vector, deg", "χ² above", "probability"]
    show.table("other poses", heads, rows if verbose else rows[:LISTED])
    _show_more(0 if verbose else len(rows) - LISTED)


def _show_more(count: int) -> None:
    if count > 0:
        show.text(f"… and {count} more (--verbose lists all)")
