"""`camcal detect`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.calibration.detect import DetectReport
    from camcal.tasks.calibration.video_frames import FrameRecord

LISTED = 50

Pattern = Annotated[
    str | None,
    typer.Option(
        metavar="LETTERS",
        help="Gray images are bare mosaics with these colours in their first 2x2 pixels: RGGB, GRBG, GBRG, BGGR.",
    ),
]
Algorithm = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Of raw frames: green, which a lens's lateral chromatic aberration leaves alone, or gray, all samples "
        "balanced: as good as a monochrome sensor where the lens has no such aberration.",
    ),
]


MaxFrames = Annotated[
    int,
    typer.Option(metavar="N", help="Frames of videos to take at most: sharp ones that tell most of the lens."),
]
Every = Annotated[int, typer.Option(metavar="K", help="Look at every K-th frame of a video only.")]
Parts = Annotated[
    bool,
    typer.Option("--partial", help="Use parts of a chessboard too where they show which part they are."),
]
MixedSizes = Annotated[
    bool,
    typer.Option(
        "--mixed-sizes",
        help="Use images of another size than most too: of half or twice the size, turned by 90 degrees, or a pixel or "
        "two off.",
    ),
]
AllFrames = Annotated[bool, typer.Option("--all-frames", help="Take all frames of videos, not chosen ones.")]


def detect(
    inputs: Annotated[list[str], typer.Argument(metavar="IMAGES…", help="Images, videos, folders and quoted globs.")],
    output: shared.Output,
    board: shared.BoardOption = None,
    pattern: Pattern = None,
    algorithm: Algorithm = "green",
    format: shared.PixelFormat = None,  # noqa: A002 - it is the option's name
    size: shared.FrameSize = None,
    stride: shared.Stride = None,
    offset: shared.Offset = 0,
    endian: shared.Endian = "little",
    align: shared.Align = "lsb",
    max_frames: MaxFrames = 40,
    every: Every = 1,
    all_frames: AllFrames = False,
    draw: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write a picture of every image with its corners, or why there are none."),
    ] = None,
    parts: Parts = False,
    mixed_sizes: MixedSizes = False,
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    max_pixels: shared.MaxPixels = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Find the corners of a board in images, videos or raw frames and write a table (.csv, or .vnl for mrcal).

    Sizes of chessboards count inner corners, sizes of ChArUco boards count squares. Images that show nothing are
    listed with the reason. Of videos sharp frames are chosen that show the board as differently as possible, and the
    choice is listed. `camcal calibrate` takes the table in place of the images.
    """
    from camcal.errors import InvalidInput, ItemsFailed
    from camcal.formats.boards import load_board
    from camcal.tasks.calibration.detect import DetectOptions, detect_images, document
    from camcal.tasks.calibration.photographs import Reading
    from camcal.tasks.calibration.video_frames import FrameOptions

    if board is None:
        raise InvalidInput("--board is needed, such as --board chessboard:9x6:25mm")
    layout = shared.given_layout(format, size, stride, offset, endian, align)
    reading = Reading(pattern, algorithm, layout=layout)
    frames = FrameOptions(max_frames, every, all_frames)
    report = detect_images(
        DetectOptions(
            tuple(inputs), load_board(board), output, recursive, jobs, reading, frames, draw, parts, mixed_sizes
        ),
        show.progress(quiet),
    )
    if json:
        show.document("detect", document(report, output))
    elif not quiet:
        _show(report, verbose)
        show.text(f"wrote {output}")
        if report.pictures:
            count = len(report.pictures)
            show.text(f"drew {count} picture{'s' if count > 1 else ''} in {draw}")
    if report.failed:
        raise ItemsFailed(f"{len(report.failed)} of the images could not be read, the rest is written")


def _show(report: "DetectReport", verbose: bool) -> None:
    filmed = {record.look.view.image for record in report.frames}
    views = [view for view in report.detections.views if view.image not in filmed]
    shown = views if verbose or len(views) <= LISTED else [view for view in views if not view.found]
    rows = [[view.image, len(view.ids), view.reason or ""] for view in shown]
    if views:
        found = sum(view.found for view in views)
        show.table(f"{found} of {len(views)} images show the board", ["image", "corners", "reason"], rows)
    if len(shown) < len(views):
        show.text(f"  … and {len(views) - len(shown)} with corners (--verbose lists all)")
    if report.frames:
        show_frames(report.frames, verbose)
    for note in report.notes:
        show.text(note)
    for message in report.failed:
        show.text(f"failed: {message}")


def show_frames(records: Sequence["FrameRecord"], verbose: bool) -> None:
    """Print which frames of videos are taken, or with `verbose` what became of all that were searched."""
    from camcal.tasks.calibration.video_frames import COLUMNS, cells

    taken = [record for record in records if record.taken]
    shown = records if verbose else taken[:LISTED]
    title = f"{len(taken)} of {len(records)} frames that were searched are taken"
    show.table(title, COLUMNS, [cells(record) for record in shown])
    if len(shown) < len(taken):
        show.text(f"  … and {len(taken) - len(shown)} more")
    if len(shown) < len(records):
        show.text("  (--verbose lists all that were searched)")
