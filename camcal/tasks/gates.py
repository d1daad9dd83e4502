"""What is asked of a camera by itself: gates that need no images, and the distances at which it measures."""

from collections.abc import Iterator
from math import degrees, inf, radians
from typing import TYPE_CHECKING, Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.options import CHECKS, NUMBER, PERCENT, Option, OptionsRecord, ValueType
from camcal.parsing import parse_number

if TYPE_CHECKING:
    from camcal.formats.camera_file import CameraEntry

TRUSTWORTHY = "trustworthy"
_NOTHING = "the file states no {}: calibrate with camcal"

_LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def trust_option(text: str) -> Option:
    """Return an option that asks for a calibration to be trustworthy."""
    return Option(text, metavar=TRUSTWORTHY, group=CHECKS, choices=(TRUSTWORTHY,), recorded=False)


@dataclass(frozen=True)
class CameraGates(OptionsRecord):
    """What cameras of a file must be: their verdict, their largest projection uncertainty (px), the least share of the
    image in which their verdict holds; None for no gate.
    """

    require: Annotated[
        str | None,
        trust_option("Exit with 7 if a camera's verdict in the file is not that it is trustworthy."),
    ] = None
    max_uncertainty: Annotated[
        float | None,
        Option(
            "Exit with 7 if the stated projection uncertainty (RMS over the area with corners) of a camera is larger.",
            metavar="PX",
            group=CHECKS,
            least=0,
            recorded=False,
        ),
    ] = None
    min_coverage: Annotated[
        float | None,
        Option(
            "Exit with 7 if the verdict of a camera holds in a smaller share of the image.",
            metavar="PERCENT",
            group=CHECKS,
            type=PERCENT,
            least=0,
            most=1,
            recorded=False,
        ),
    ] = None

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return self != NO_GATES

    def failures(self, camera: str, entry: "CameraEntry") -> Iterator[Message]:
        """Yield a failure for every gate that a camera of this name does not pass; what is not stated does not pass."""
        _, reached, share = stated(entry).values()
        if self.require is not None and entry.verdict is None:
            yield Message("not_stated", _NOTHING.format("verdict"), {}, camera)
        elif self.require is not None and entry.verdict is not None and not entry.verdict.trustworthy:
            reasons = "; ".join(entry.verdict.reasons) or "the file gives no reason"
            yield Message("untrustworthy", f"not trustworthy: {reasons}", {}, camera)
        limit = self.max_uncertainty
        if limit is not None and (reached is None or reached > limit):
            if reached is None:
                yield Message("not_stated", _NOTHING.format("projection uncertainty"), {}, camera)
            else:
                text = f"projection uncertainty {reached:.3g} px (limit {limit:g} px)"
                yield Message("projection_uncertainty", text, {"uncertainty_px": reached, "limit_px": limit}, camera)
        least = self.min_coverage
        if least is not None and (share is None or share < least):
            if share is None:
                yield Message("not_stated", _NOTHING.format("region of its verdict"), {}, camera)
            else:
                text = f"the verdict holds in {100 * share:.0f} % of the image (limit {100 * least:g} %)"
                yield Message("small_region", text, {"share": share, "limit": least}, camera)


NO_GATES = CameraGates()


def stated(entry: "CameraEntry") -> dict[str, float | None]:
    """Return what a file says of a camera: trustworthy, projection uncertainty_px at infinity (RMS over the area with
    corners, or else the image), coverage, the share of the image in which the verdict holds; None for what it does not.
    """
    far = next((item.figures for item in entry.projection if item.range_m is None), {})
    region = entry.verdict.region if entry.verdict is not None else None
    return {
        "trustworthy": None if entry.verdict is None else entry.verdict.trustworthy,
        "uncertainty_px": far.get("inside_rms_px", far.get("rms_px")),
        "coverage": None if region is None else region.share,
    }


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
