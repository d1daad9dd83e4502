"""What stands below a board on its page: a ruler to check the print with, and what the board is."""

from dataclasses import dataclass

from camcal.arrays import Array
from camcal.targets.printing.page import Text, rectangle, text_width

RULER_MM = 100

_HEIGHT = 5.0  # of the ruler with its numbers, and of two lines of text
_GAP = 2.0  # between them where one stands above the other
_BESIDE = 8.0  # between them where they stand side by side
_LINE = 0.2  # thickness
_TICKS = {10: 3.0, 5: 2.2, 1: 1.4}  # length by what the millimetre is a multiple of
_NUMBERS = 2.0  # size of the ruler's numbers
_OVERHANG = (1.0, 6.0)  # of the ruler's first and last number
_SIZES = (2.8, 2.4)  # of the first and the second line of text
_BASELINES = (3.1, 0.3)  # above the lower edge


@dataclass(frozen=True)
class Footer:
    """A title and a line of small print, and a ruler of 100 mm or none; lengths in mm."""

    title: str
    small: str
    ruler: bool = True

    @property
    def overhang(self) -> float:
        """How far the footer begins before the ruler's zero and the text above it."""
        return _OVERHANG[0] if self.ruler else 0.0

    @property
    def ruler_width(self) -> float:
        """The width of the ruler with its numbers, 0 without one."""
        return RULER_MM + sum(_OVERHANG) if self.ruler else 0.0

    def width(self, room: float) -> float:
        """Return the width that the footer takes of `room`: ruler and text are side by side if that is enough."""
        if self.ruler and not self._stacked(room):
            return self.ruler_width + _BESIDE + self._text_width
        return max(self.ruler_width, min(self.overhang + self._text_width, room))

    def height(self, room: float) -> float:
        """Return the height of the footer in a page with `room` between the margins."""
        return _HEIGHT + _GAP + _HEIGHT if self._stacked(room) else _HEIGHT

    def _stacked(self, room: float) -> bool:
        return self.ruler and self.ruler_width + _BESIDE + self._text_width > room

    @property
    def _text_width(self) -> float:
        return max(map(text_width, (self.title, self.small), _SIZES))

    def drawn(self, left: float, bottom: float, room: float) -> tuple[tuple[Array, ...], tuple[Text, ...]]:
        """Return the shapes and the lines of text of a footer whose lower left corner is at left, bottom."""
        if not self.ruler:
            return (), self._words(left, bottom, room)
        shapes, numbers = _ruler(left + self.overhang, bottom)
        if self._stacked(room):
            words = self._words(left + self.overhang, bottom - _HEIGHT - _GAP, room - self.overhang)
        else:
            beside = self.ruler_width + _BESIDE
            words = self._words(left + beside, bottom, room - beside)
        return shapes, (*numbers, *words)

    def _words(self, left: float, bottom: float, room: float) -> tuple[Text, ...]:
        """Return the two lines, small enough for their room."""
        lines = zip((self.title, self.small), _SIZES, _BASELINES, strict=True)
        return tuple(
            Text(left, bottom - above, size * min(1.0, room / text_width(words, size)), words)
            for words, size, above in lines
        )


def _ruler(left: float, bottom: float) -> tuple[tuple[Array, ...], tuple[Text, ...]]:
    """Return a ruler whose zero is at `left`: a line, ticks centred on the millimetres, a number every ten."""
    shapes = [rectangle(left, bottom - _LINE, left + RULER_MM, bottom)]
    for place in range(RULER_MM + 1):
        length = next(length for multiple, length in _TICKS.items() if place % multiple == 0)
        middle = left + place
        shapes.append(rectangle(middle - _LINE / 2, bottom - length, middle + _LINE / 2, bottom))
    baseline = bottom - max(_TICKS.values()) - 0.5
    words = {place: str(place) for place in range(0, RULER_MM + 1, 10)}
    numbers = [
        Text(left + place - text_width(word, _NUMBERS) / 2, baseline, _NUMBERS, word) for place, word in words.items()
    ]
    unit = Text(numbers[-1].x + numbers[-1].width + 0.6, baseline, _NUMBERS, "mm")
    return tuple(shapes), (*numbers, unit)
