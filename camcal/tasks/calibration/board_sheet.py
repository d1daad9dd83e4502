"""`camcal board`: a board as a sheet to print at true scale, and the board file that goes with it."""

from pathlib import Path
from typing import Any

from camcal import files
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import boards, emit, provenance
from camcal.formats.boards import short_form
from camcal.progress import SILENT, Progress
from camcal.run.outputs import claim, overwrites, writes
from camcal.targets.board import APRILGRID, ASYMMETRIC_CIRCLES, CHARUCO, CHESSBOARD, Board
from camcal.targets.page import Page, Paper, paper_named, size_in_pixels
from camcal.targets.printing import MM, RULER_MM, Footer, Ink, Sheet, encoded, ink_of, page_of, require_fine
from camcal.tasks.calibration.drawing_options import SheetOptions

DPI = 254.0  # ten pixels a millimetre


@dataclass(frozen=True, eq=False)
class BoardSheet:
    """A board as it was drawn. pixels: width and height of a PNG, None of other files."""

    options: SheetOptions
    board: Board
    paper: Paper
    ink: Ink
    pixels: tuple[int, int] | None


@writes
def board_sheet(options: SheetOptions, _: Progress = SILENT) -> BoardSheet:
    """Return how a board was drawn, the drawing and the board files written; one that is there already is kept.

    Raises InvalidInput for a board without size or one that does not fit, and if a file of another board is in the way.
    """
    board = _as_printed(boards.load_board(options.board))
    ink = ink_of(board)
    wanted = None if options.paper is None else paper_named(options.paper)
    sheet = Sheet(wanted, options.landscape, options.margin_mm)
    page, paper = page_of(ink, _footer(board, ruler=options.ruler), sheet)
    pixels = _pixels(options, ink, page)
    there, target = _is_there(options.board_file, board), _target(options, board)
    claim([options.output] if there else [options.output, options.board_file])
    files.write_bytes(options.output, encoded(page, options.output, options.dpi or DPI, provenance.created()))
    if not there:
        boards.write(options.board_file, board)
    if options.kalibr is not None:
        files.write_text(options.kalibr, target)
    return BoardSheet(options, board, paper, ink, pixels)


def document(sheet: BoardSheet) -> dict[str, Any]:
    """Return how a board was drawn as plain data for --json."""
    options, paper, ink = sheet.options, sheet.paper, sheet.ink
    return {
        "output": options.output.as_posix(),
        "board_file": options.board_file.as_posix(),
        "kalibr_file": None if options.kalibr is None else options.kalibr.as_posix(),
        "board": boards.block(sheet.board),
        "paper": {"name": paper.name, "width_mm": paper.width, "height_mm": paper.height, "landscape": paper.landscape},
        "margin_mm": options.margin_mm,
        "board_mm": list(ink.size),
        "white_border_mm": ink.quiet,
        "ruler_mm": RULER_MM if options.ruler else None,
        "dpi": None if sheet.pixels is None else options.dpi or DPI,
        "pixels": sheet.pixels,
    }


def _as_printed(board: Board) -> Board:
    """Return the board with the pattern it is printed with: of ChArUco boards that do not say, the current one."""
    return replace(board, legacy=bool(board.legacy)) if board.type == CHARUCO else board


def _pixels(options: SheetOptions, ink: Ink, page: Page) -> tuple[int, int] | None:
    """Return the size of a PNG file, None for others; InvalidInput if it has too many pixels or too few."""
    if options.output.suffix.lower() != ".png":
        return None
    dpi = options.dpi or DPI
    require_fine(ink, dpi)
    return size_in_pixels(page, dpi)


def _is_there(path: Path, board: Board) -> bool:
    """Return whether a file describes the board already; raises InvalidInput if it is something else."""
    if not path.exists() or overwrites():
        return False
    try:
        with files.unwatched():
            found = boards.read(path)
    except CamcalError as error:
        raise InvalidInput("is not a board file and is not replaced; choose another output", where=str(path)) from error
    if emit.rounded(boards.block(_as_printed(found))) != emit.rounded(boards.block(board)):
        raise InvalidInput("describes another board and is not replaced; choose another output", where=str(path))
    return True


def _target(options: SheetOptions, board: Board) -> str:
    """Return the text of the target file for Kalibr, "" if none is wanted; InvalidInput if its place is taken."""
    path = options.kalibr
    if path is None:
        return ""
    text = boards.kalibr_text(board)
    if path.resolve() in (options.output.resolve(), options.board_file.resolve()):
        raise InvalidInput("is another output; choose another name for the Kalibr file", where=str(path))
    return text


def _footer(board: Board, *, ruler: bool) -> Footer:
    title = f"{board.words[0].upper()}{board.words[1:]}, {_lengths(board)}"
    advice = f"print at 100 %: the ruler is {RULER_MM} mm long" if ruler else "print at 100 %"
    named = short_form(board) if not board.first_marker else f"first marker {board.first_marker}"
    return Footer(title, f"{named} - {advice}", ruler)


def _lengths(board: Board) -> str:
    """Return the lengths of a board in words."""
    lengths = (board.square, board.marker, board.diameter)
    spacing, marker, diameter = (f"{(length or 0.0) * MM:.6g} mm" for length in lengths)
    if board.type == CHESSBOARD:
        return f"squares of {spacing}"
    if board.type == CHARUCO:
        return f"squares of {spacing}, markers of {marker}, {board.dictionary}"
    if board.type == APRILGRID:
        return f"tags of {marker}, {spacing} from tag to tag, {board.dictionary}"
    return f"{'rows ' if board.type == ASYMMETRIC_CIRCLES else ''}{spacing} apart, diameter {diameter}"
