"""Printing for the tests: boards on their pages, and what a rasteriser makes of a file. No ink spreads here."""

import cv2
import numpy as np
import pypdfium2

from camcal.targets.board import parse_board
from camcal.targets.printing import Footer, Sheet, ink_of, page_of

FOOTER = Footer("A (title) with \\ & < signs", "small print")
DPI = 127  # 5 pixels a millimetre: a page of whole millimetres has whole pixels
BOARDS = (
    "chessboard:9x6:25mm",
    "chessboard:9x6:25mm:dots",
    "charuco:5x7:35mm:26mm:DICT_5X5_100",
    "charuco:5x8:30mm:22mm:DICT_4X4_50:legacy",
    "aprilgrid:4x3:40mm:0.3",
    "circles:7x6:25mm:15mm",
    "asymmetric_circles:4x11:20mm:15mm",
)


def page_with(text, **sheet):
    """Return the page of a board."""
    return page_of(ink_of(parse_board(text)), FOOTER, Sheet(**sheet))[0]


def rasterised(content, dpi=DPI):
    """Return the page (H, W) uint8 of a PDF file."""
    with pypdfium2.PdfDocument(content) as document:
        return document[0].render(scale=dpi / 72, grayscale=True).to_numpy().copy()


def decoded(content):
    """Return the image (H, W) uint8 of a PNG file."""
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
