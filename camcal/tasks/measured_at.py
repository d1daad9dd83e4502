"""At which distances something is asked of a camera: options that commands share."""

from math import degrees, inf, radians
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.options import NUMBER, Option, OptionsRecord, ValueType
from camcal.parsing import parse_number

_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def _read_length(text: str) -> float:
    """Return a length in metres, written with its unit mm, cm or m, or without."""
    unit = next((each for each in _LENGTHS if text.endswith(each)), "")
    length = _LENGTHS.get(unit, 1.0) * parse_number(text.removesuffix(unit))
    if not 0 < length < inf:
        raise ValueError(text)
    return length


def _write_length(value: float) -> str:
    return f"{NUMBER.write(value)}m"


LENGTH = ValueType(_read_length, _write_length, "a length such as 100mm, 10cm or 0.1m")
LENGTHS = ValueType(
    lambda text: tuple(map(_read_length, text.split(","))),
    lambda values: ",".join(map(_write_length, values)),
    "lengths such as 0.5m,800mm, separated by commas",
)


def _read_noise(text: str) -> tuple[float, float]:
    """Return standard deviations of position (m) and rotation (rad), written as a length and an angle in degrees."""
    place, _, turn = text.partition(",")
    angle = radians(parse_number(turn.removesuffix("deg")))
    if not 0 < angle < inf:
        raise ValueError(text)
    return _read_length(place), angle


ROBOT_NOISE = ValueType(
    _read_noise, lambda noise: f"{_write_length(noise[0])},{degrees(noise[1]):.17g}deg", "noise such as 0.5mm,0.06deg"
)


@dataclass(frozen=True)
class MeasuredAt(OptionsRecord):
    """Distances (m) at which the errors of measurements are asked for, and the length of an object, m."""

    distances: Annotated[
        tuple[float, ...],
        Option(
            "Also show the errors at these distances: of a projected point, a length, a depth.",
            metavar="LENGTH,…",
            names="--at",
            type=LENGTHS,
            recorded=False,
        ),
    ] = ()
    length: Annotated[
        float | None,
        Option("Length of an object whose error is shown, with --at.", metavar="LENGTH", type=LENGTH, recorded=False),
    ] = None

    def __post_init__(self) -> None:
        if self.length is not None and not self.distances:
            raise InvalidInput("--length needs a distance: add --at, such as --at 0.8m")


NOWHERE = MeasuredAt()
