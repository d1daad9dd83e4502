"""`camcal detect`."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from camcal.cli import show
from camcal.cli.command import ImageCall
from camcal.tasks.calibration.options import DetectOptions

if TYPE_CHECKING:
    from camcal.tasks.calibration.detect import DetectReport
    from camcal.tasks.calibration.video_frames import FrameRecord

LISTED = 50


def detect(options: DetectOptions, call: ImageCall) -> None:
    """Find the corners of a board in images, videos or raw frames and write a table (.csv, or .vnl for mrcal).

    Sizes of chessboards count inner corners, sizes of ChArUco boards count squares. Images that show nothing are
    listed with the reason. Of videos sharp frames are chosen that show the board as differently as possible, and the
    choice is listed. `camcal calibrate` takes the table in place of the images.
    """
    from camcal.errors import ItemsFailed
    from camcal.tasks.calibration.detect import detect_images, document

    report = detect_images(options, call.progress)
    call.give(lambda: document(report, options.output), lambda: _show(report, options, call.verbose))
    if report.failed:
        raise ItemsFailed(f"{len(report.failed)} of the images could not be read, the rest is written")


def _show(report: "DetectReport", options: DetectOptions, verbose: bool) -> None:
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
    show.text(f"wrote {options.output}")
    if report.pictures:
        count = len(report.pictures)
        show.text(f"drew {count} picture{'s' if count > 1 else ''} in {options.draw}")


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
