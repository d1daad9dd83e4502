"""`camcal detect`."""

from typing import TYPE_CHECKING, Annotated

import typer

from camcal.cli import options as shared
from camcal.cli import show

if TYPE_CHECKING:
    from camcal.tasks.calibration.detect import DetectReport

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


def detect(
    inputs: Annotated[list[str], typer.Argument(metavar="IMAGES…", help="Images, folders and quoted globs.")],
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
    recursive: shared.Recursive = False,
    jobs: shared.Jobs = None,
    json: shared.Json = False,
    quiet: shared.Quiet = False,
    verbose: shared.Verbose = False,
    config: shared.Config = None,
) -> None:
    """Find the corners of a board in images or raw frames and write them as a table (.csv, or .vnl for mrcal).

    Sizes of chessboards count inner corners, sizes of ChArUco boards count squares. Images that show nothing are
    listed with the reason. `camcal calibrate` takes the table in place of the images.
    """
    from camcal.errors import InvalidInput, ItemsFailed
    from camcal.formats.boards import load_board
    from camcal.tasks.calibration.detect import DetectOptions, detect_images, document
    from camcal.tasks.calibration.photographs import Reading

    if board is None:
        raise InvalidInput("--board is needed, such as --board chessboard:9x6:25mm")
    layout = shared.given_layout(format, size, stride, offset, endian, align)
    reading = Reading(pattern, algorithm, layout=layout)
    report = detect_images(
        DetectOptions(tuple(inputs), load_board(board), output, recursive, jobs, reading), show.progress(quiet)
    )
    if json:
        show.document("detect", document(report, output))
    elif not quiet:
        _show(report, verbose)
        show.text(f"wrote {output}")
    if report.failed:
        raise ItemsFailed(f"{len(report.failed)} of the images could not be read, the rest is written")


def _show(report: "DetectReport", verbose: bool) -> None:
    views = report.detections.views
    shown = views if verbose or len(views) <= LISTED else [view for view in views if not view.found]
    rows = [[view.image, len(view.ids), view.reason or ""] for view in shown]
    show.table(f"{report.used} of {len(views)} images show the board", ["image", "corners", "reason"], rows)
    if len(shown) < len(views):
        show.text(f"  … and {len(views) - len(shown)} with corners (--verbose lists all)")
    for note in report.notes:
        show.text(note)
    for message in report.failed:
        show.text(f"failed: {message}")
