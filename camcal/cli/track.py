"""`camcal track`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.estimate.tracking.process_noise import ProcessNoise
    from camcal.tasks.poses.track import FollowReport


def track(
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="CAMERA VIDEO|IMAGES… | POSES",
            help="Camera file (or FILE#NAME) and a video, a folder or images; or a pose file of 'camcal pnp' alone.",
        ),
    ],
    board: shared.BoardOption = None,
    tags: Annotated[
        str | None,
        typer.Option(metavar="TAGS", help="A tag file, or a short form such as tag36h11:53mm or tag36h11:53mm:0,1,5."),
    ] = None,
    chosen: Annotated[
        str | None, typer.Option("--object", metavar="NAME", help="Which object to follow; by default all.")
    ] = None,
    tag_id: Annotated[int | None, typer.Option("--id", metavar="N", min=0, help="The same by the id of a tag.")] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="Where to write: .csv, .yaml or .json with all frames and their state; .tum with poses only.",
        ),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="tum, kitti or tf (ROS transforms as .yaml): poses only."),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Positions, angles and NIS over time: .png, .svg or .pdf.")
    ] = None,
    pose: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="camera_T_object, or object_T_camera, which is the default for .tum: a camera's path."
        ),
    ] = None,
    fps: Annotated[float | None, typer.Option(metavar="RATE", help="Frames per second; a video has its own.")] = None,
    timestamps: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|name|exif",
            help="Times of the frames: a file (a line each, or CSV with image,t), the last number of their names or "
            "name:REGEX (with --fps it counts frames), or EXIF.",
        ),
    ] = None,
    time_unit: Annotated[str, typer.Option(metavar="s|ms|us|ns", help="Of times in files and names.")] = "s",
    process_noise: Annotated[
        str,
        typer.Option(
            metavar="auto|QV,QW",
            help="How strongly the motion accelerates, m²/s³ and rad²/s³; auto takes what the frames make likeliest.",
        ),
    ] = "auto",
    gate: Annotated[
        float, typer.Option(metavar="P", help="Of a pose file: detections less likely than 1 - P are left out.")
    ] = 0.999,
    max_gap: Annotated[
        float, typer.Option(metavar="SECONDS", help="A longer time without a detection ends a piece of the track.")
    ] = 1.0,
    fill: Annotated[
        bool, typer.Option("--fill", help="Give poses for frames without a detection, within a piece only.")
    ] = False,
    causal: Annotated[bool, typer.Option("--causal", help="Every pose from the frames up to it alone.")] = False,
    lag: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Every pose from the frames up to N later ones.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            metavar="PX",
            help="Standard deviation of every pixel coordinate; by default from corner detection and the residuals.",
        ),
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
    """Follow a board or tags over a video, a folder of images or a pose file: smooth poses with their uncertainty.

    Detections that do not fit are left out, mirrored poses of flat objects are told apart by the motion, and where the
    object is lost the track ends and another begins. It says whether the uncertainty is to be trusted.
    """
    from camcal.errors import InvalidInput, ItemsFailed
    from camcal.estimate.tracking.segments import Following
    from camcal.estimate.tracking.track import TrackOptions
    from camcal.targets.markers.tags import single_name
    from camcal.tasks.poses.frame_times import Timing
    from camcal.tasks.poses.pnp_views import Looking
    from camcal.tasks.poses.track import FollowOptions, document, names_camera
    from camcal.tasks.poses.track import track as run

    if causal and lag:
        raise InvalidInput("--causal looks no frame ahead and --lag some: give one of them")
    if chosen is not None and tag_id is not None:
        raise InvalidInput("--object and --id both choose an object: give one of them")
    camera_file = inputs[0] if names_camera(inputs) else None
    tracking = TrackOptions(_process_noise(process_noise), Following(gate, max_gap), 0 if causal else lag, fill)
    options = FollowOptions(
        tuple(inputs[1:] if camera_file else inputs[-1:]),
        camera_file,
        Looking(board, tags, recursive=recursive, jobs=jobs),
        camera,
        noise,
        Timing(fps, timestamps, time_unit),
        chosen if tag_id is None else single_name(tag_id),
        tracking,
        pose,
        output,
        kind,
        plot,
    )
    report = run(options, show.progress(quiet))
    if json:
        show.document("track", document(report))
    elif not quiet:
        _show(report, verbose)
    if report.lost or report.failed:
        lost = [f"{name}: {error.message}" for name, error in report.lost.items()]
        raise ItemsFailed(f"some failed, the rest is followed: {'; '.join((*lost, *report.failed))}")


def _process_noise(text: str) -> "ProcessNoise | None":
    from camcal.errors import InvalidInput
    from camcal.estimate.tracking.process_noise import ProcessNoise

    if text == "auto":
        return None
    numbers = shared.parse_numbers("--process-noise", text)
    if len(numbers) != 2:
        raise InvalidInput(f"--process-noise {text!r}: auto, or two numbers such as 0.02,0.5")
    return ProcessNoise(*numbers)


def _show(report: "FollowReport", verbose: bool) -> None:
    from camcal.report.track_words import lines, plain

    for note in report.notes:
        show.text(note)
    for name, item in report.objects.items():
        show.text(f"{item.track.frames}{f', {name}' if name else ''}:")
        for line in lines(item):
            show.text(f"  {line}")
        if verbose:
            for image in plain(item, report.images)["rejected"]:
                show.text(f"  left out: {image}")
    for path in report.outputs:
        show.text(f"wrote {path}")
