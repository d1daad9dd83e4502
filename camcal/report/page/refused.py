"""The report on detections that no calibration can be made from: why, what to do, and what was detected."""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.messages import Message, counted
from camcal.report.page.record import DataBlock, Figure, Page, Section, Table, Thumbnail
from camcal.report.page.thumbnails import MOST, corner_thumbnail, photo_key
from camcal.report.page.verdict import refusal
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection


def refused_page(
    title: str,
    board: Board,
    views: Sequence[BoardDetection],
    failure: Message,
    made: str,
    closing: Sequence[Section],
    blocks: Sequence[DataBlock],
    photos: Mapping[str, str],
) -> Page:
    """Return the report; failure: why there is no calibration. closing: the last sections."""
    verdict, shown = refusal(failure)
    found = [view for view in views if view.found]
    lines = ["Blue dots: detected corners. The corner ids of all views have to be those of the board that is given."]
    return Page(
        title,
        f"{counted(len(views), 'image')}, board: {board.words}",
        verdict,
        (shown,),
        figures=tuple(_figures(board, views)),
        sections=(
            Section("images", "Images", lines, thumbnails=_thumbnails(found, photos), tables=[_table(views)]),
            *closing,
        ),
        made=made,
        blocks=blocks,
    )


def _figures(board: Board, views: Sequence[BoardDetection]) -> list[Figure]:
    found = [view for view in views if view.found]
    corners = sum(len(view.ids) for view in found)
    each = f"median {np.median([len(view.ids) for view in found]):.0f} of {board.count} in a view" if found else ""
    return [
        Figure("Images with the board", f"{len(found)} of {len(views)}"),
        Figure("Corners detected", f"{corners}", each),
    ]


def _thumbnails(views: Sequence[BoardDetection], photos: Mapping[str, str]) -> list[Thumbnail]:
    return [corner_thumbnail(view, photos.get(photo_key(view.camera, view.image), "")) for view in views[:MOST]]


def _table(views: Sequence[BoardDetection]) -> Table:
    rows = [[photo_key(view.camera, view.image), f"{len(view.ids)}", view.reason or ""] for view in views]
    return Table.of("All images", ("image", "corners", "no corners because"), rows)
