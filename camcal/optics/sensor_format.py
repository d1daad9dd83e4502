"""Sensor formats by name. The "inch" of a format refers to camera tubes, not to the sensor size."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import hypot
from types import MappingProxyType

from camcal.errors import InvalidInput
from camcal.parsing import nearest

_INCH_SMALL_MM, _INCH_LARGE_MM = 18.0, 16.0  # of diagonal, for sensors up to half an inch and above
_HALF_INCH = 0.5
_LARGEST_INCH = 2.0
_ASPECT = 4 / 3  # of a format that is known by its inches alone


@dataclass(frozen=True)
class SensorFormat:
    """A format by its name, with the usual width and height of its sensors."""

    name: str
    width_mm: float
    height_mm: float

    @property
    def diagonal_mm(self) -> float:
        """The diagonal, mm."""
        return hypot(self.width_mm, self.height_mm)


# Sizes from the data sheets of common sensors; makers differ by a few percent.
_SIZES = {
    '1/4"': (3.6, 2.7),
    '1/3.6"': (4.0, 3.0),
    '1/3.2"': (4.54, 3.42),
    '1/3"': (4.8, 3.6),
    '1/2.9"': (4.96, 3.72),
    '1/2.8"': (5.57, 3.13),
    '1/2.7"': (5.37, 4.04),
    '1/2.5"': (5.76, 4.29),
    '1/2.3"': (6.17, 4.55),
    '1/2"': (6.4, 4.8),
    '1/1.8"': (7.18, 5.32),
    '1/1.7"': (7.6, 5.7),
    '2/3"': (8.8, 6.6),
    '1/1.2"': (10.67, 8.0),
    '1"': (13.2, 8.8),
    '1.1"': (14.2, 10.4),
    "4/3": (17.3, 13.0),
    "APS-C": (23.5, 15.6),
    "APS-C Canon": (22.3, 14.9),
    "APS-H": (28.7, 19.0),
    "full frame": (36.0, 24.0),
    "44x33": (43.8, 32.9),
}
FORMATS: Mapping[str, SensorFormat] = MappingProxyType(
    {name: SensorFormat(name, *size) for name, size in _SIZES.items()}
)

_OTHER_NAMES = {'4/3"': "4/3", "four thirds": "4/3", "micro four thirds": "4/3", "35mm": "full frame"}
_INCHES = re.compile(r'(?:([0-9]+)/)?([0-9]+(?:\.[0-9]+)?) ?(?:"|″|in|inch|-type)?')


def sensor_format(text: str) -> SensorFormat:
    """Return the format of a name such as 1/2.8, 2/3", APS-C or full frame, whatever the case.

    Fractions of an inch that are not in the list have the diagonal of the rule: 18 mm an inch up to 1/2", 16 mm above.
    Raises InvalidInput, with the nearest name, for anything else.
    """
    plain = " ".join(text.lower().replace("_", " ").split())
    names = {name.lower(): name for name in (*FORMATS, *_OTHER_NAMES)}
    inches = _INCHES.fullmatch(plain)
    for known in (plain, _fraction(inches) if inches else plain):
        if known in names:
            return FORMATS[_OTHER_NAMES.get(names[known], names[known])]
    if inches and 0 < (size := _in_inches(inches)) <= _LARGEST_INCH:
        diagonal = size * (_INCH_SMALL_MM if size <= _HALF_INCH else _INCH_LARGE_MM)
        height = diagonal / hypot(_ASPECT, 1)
        return SensorFormat(_fraction(inches), _ASPECT * height, height)
    near = nearest(plain, names)
    advice = f". Did you mean '{names[near]}'?" if near else f"; known: {', '.join(FORMATS)}"
    raise InvalidInput(f"sensor format {text!r} is unknown{advice}")


def smallest_format(width: float) -> SensorFormat | None:
    """Return the smallest format of the list that is at least `width` (m) wide, None if there is none."""
    wide = [known for known in FORMATS.values() if known.width_mm >= 1e3 * width]
    return min(wide, key=lambda known: known.diagonal_mm, default=None)


def pixel_pitch(sensor: SensorFormat, image_size: tuple[int, int]) -> float:
    """Return the distance of pixels (m) if an image of `image_size` (width, height) fills the format's diagonal."""
    return sensor.diagonal_mm / 1e3 / hypot(*image_size)


def literal_mm(sensor: SensorFormat) -> float | None:
    """Return what the inch in a format's name would be in mm, None for a name without one. No sensor has it."""
    inches = _INCHES.fullmatch(sensor.name) if sensor.name.endswith('"') else None
    return None if inches is None else round(25.4 * _in_inches(inches), 2)


def _fraction(inches: re.Match[str]) -> str:
    """Return inches as the list writes them."""
    over, number = inches.groups()
    return f'{over}/{float(number):g}"' if over else f'{float(number):g}"'


def _in_inches(inches: re.Match[str]) -> float:
    over, number = inches.groups()
    if float(number) == 0:
        return 0.0
    return float(over) / float(number) if over else float(number)
