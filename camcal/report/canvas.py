"""Pictures to draw on: an image at a whole scale, marks at fractions of its pixels, words that can be read."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from camcal.arrays import Array

Colour = tuple[int, int, int]  # blue, green, red

INK, PAPER = (30, 30, 30), 245
LEAST_WIDTH = 900  # px; smaller images are enlarged by a whole factor, so that marks and letters can be seen
_EDGE: Colour = (20, 20, 20)
_AROUND = tuple((right, down) for right in (-1, 0, 1) for down in (-1, 0, 1) if right or down)
_FAR = 20.0  # picture widths; what is drawn farther out is not in the picture
_FINE = 4  # bits of a fraction of a pixel that OpenCV draws with
_LETTERS = cv2.FONT_HERSHEY_SIMPLEX
_SIZE = 0.55  # of letters, with lines of one pixel

Place = tuple[int, int]  # in the picture, as OpenCV takes it: multiples of 2⁻⁴ px


@dataclass(frozen=True, eq=False)
class Canvas:
    """A picture (H, W, 3) of an image, `scale` of its pixels for one of the image."""

    pixels: Array
    scale: float

    @classmethod
    def of(cls, gray: Array, most_width: int | None = None) -> "Canvas":
        """Return a picture of an image (H, W) uint8, dimmed so that marks stand out.

        Images narrower than LEAST_WIDTH are enlarged, those wider than `most_width` reduced, by whole factors.
        """
        width = gray.shape[1]
        if most_width is not None and width > most_width:
            factor = -(-width // most_width)
            size = (max(1, width // factor), max(1, gray.shape[0] // factor))
            gray = gray[: size[1] * factor, : size[0] * factor]
            scale, shown = 1 / factor, cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
        else:
            scale = float(-(-LEAST_WIDTH // width))
            shown = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        return cls(cv2.cvtColor((0.55 * shown + 70).astype(np.uint8), cv2.COLOR_GRAY2BGR), scale)

    @property
    def thickness(self) -> int:
        """How thick a line is, px."""
        return max(1, round(float(self.pixels.shape[1]) / LEAST_WIDTH))

    def place(self, pixel: Array) -> Place | None:
        """Return where a pixel of the image is in the picture; None if it is nowhere or far outside."""
        if not np.isfinite(pixel).all() or np.abs(pixel).max() * self.scale > _FAR * self.pixels.shape[1]:
            return None
        x, y = ((pixel + 0.5) * self.scale - 0.5) * (1 << _FINE)
        return round(x), round(y)

    def line(self, start: Place | None, end: Place | None, colour: Colour, width: int) -> None:
        """Draw a line between two places of which both are there."""
        if start is not None and end is not None:
            cv2.line(self.pixels, start, end, colour, width, cv2.LINE_AA, _FINE)

    def polygon(self, places: Sequence[Place | None], colour: Colour, width: int) -> None:
        """Draw a closed line through places, if all are there."""
        if all(place is not None for place in places):
            cv2.polylines(self.pixels, [np.array(places, np.int32)], True, colour, width, cv2.LINE_AA, _FINE)

    def circle(self, place: Place, radius: float, colour: Colour, width: int) -> None:
        """Draw a circle of a radius in pixels of the picture."""
        cv2.circle(self.pixels, place, round(radius * (1 << _FINE)), colour, width, cv2.LINE_AA, _FINE)

    def cross(self, place: Place, reach: int, colour: Colour, width: int) -> None:
        """Draw a lying cross that reaches so many pixels of the picture."""
        (x, y), reach = place, reach << _FINE
        for sign in (-1, 1):
            self.line((x - reach, y - sign * reach), (x + reach, y + sign * reach), colour, width)

    def write(self, text: str, place: Place, colour: Colour, size: float = 1.0) -> None:
        """Write beside a place, on a dark edge that sets it off from whatever is there."""
        corner = (place[0] >> _FINE) + round(6 * size), (place[1] >> _FINE) - round(4 * size)
        width = max(1, round(size))
        # The edge is the same thin text moved about: bold letters of OpenCV 5 are wider and would stand beside it.
        for right, down, ink in (*((*move, _EDGE) for move in _AROUND), (0, 0, colour)):
            at = corner[0] + right * width, corner[1] + down * width
            cv2.putText(self.pixels, _ascii(text), at, _LETTERS, _SIZE * size, ink, width, cv2.LINE_AA)

    def captioned(self, lines: Sequence[str]) -> Array:
        """Return the picture (H', W, 3) with lines of words below it."""
        return np.concatenate([self.pixels, _caption(lines, self.pixels.shape[1])])


def _caption(lines: Sequence[str], width: int) -> Array:
    """Return a strip (H, width, 3) with lines of text."""
    size = width / LEAST_WIDTH * 0.5
    step, thickness = round(40 * size), max(1, round(size))
    strip = np.full((step * len(lines) + step // 2, width, 3), PAPER, np.uint8)
    for row, line in enumerate(lines, start=1):
        text = _ascii(line)
        needed = cv2.getTextSize(text, _LETTERS, size, thickness)[0][0]
        fitting = size * min(1.0, (width - step) / needed)
        cv2.putText(strip, text, (step // 2, row * step), _LETTERS, fitting, INK, thickness, cv2.LINE_AA)
    return strip


def _ascii(text: str) -> str:
    """Return a text in OpenCV's letters."""
    return text.encode("ascii", "replace").decode()
