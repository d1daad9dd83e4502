"""Options of stereo matching."""

from math import isfinite
from typing import Annotated

from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.images.options import require_view
from camcal.options import SIZE, Option, OptionsRecord, ValueType, separated
from camcal.parsing import parse_integer

FAST, BALANCED, BEST = "fast", "balanced", "best"
QUALITIES = (FAST, BALANCED, BEST)
NOTHING, BACKGROUND, ALL = "none", "background", "all"
FILLS = (NOTHING, BACKGROUND, ALL)
_EXPOSURES = {"auto": True, "off": False}
_SWITCHES = {"on": True, **_EXPOSURES}


def _read_range(text: str) -> tuple[int, int] | None:
    if text == "auto":
        return None
    first, last = (parse_integer(part) for part in text.split(":"))
    return first, last


def _word(words: dict[str, bool]) -> ValueType:
    """Return the type of an option whose words stand for values."""

    def read(text: str) -> bool:
        if text not in words:
            raise ValueError(text)
        return words[text]

    named = {value: word for word, value in words.items()}
    return ValueType(read, lambda value: named[value], f"one of {', '.join(words)}")


@dataclass(frozen=True)
class MatchOptions(OptionsRecord):
    """How a pair is matched.

    quality: fast, balanced or best. search: smallest and largest disparity, pixels, None for what the images show.
    fill: none; background, in rows where something is matched; all. align_rows: put the rows of the right image right
    if they are measurably off. expose_alike: bring both images to one exposure.
    """

    quality: Annotated[
        str,
        Option(
            "best (two matchers, fused), balanced (one matcher) or fast (one pass).",
            metavar="NAME",
            choices=QUALITIES,
        ),
    ] = BEST
    search: Annotated[
        tuple[int, int] | None,
        Option(
            "Range of disparities to search, pixels; auto (default): estimated from the images.",
            metavar="MIN:MAX",
            names="--range",
            type=ValueType(_read_range, lambda ends: "{}:{}".format(*ends), "auto, or whole numbers as 0:128"),
        ),
    ] = None
    fill: Annotated[
        str,
        Option(
            "Fill gaps: none, background (from the farther side of a row) or all (whole rows too).",
            metavar="NAME",
            choices=FILLS,
        ),
    ] = NOTHING
    align_rows: Annotated[
        bool,
        Option(
            "Correct row offsets of the right image.",
            metavar="auto|on|off",
            type=_word(_SWITCHES),
        ),
    ] = True
    expose_alike: Annotated[
        bool,
        Option(
            "Correct exposure differences that matched pixels show.",
            metavar="auto|off",
            names="--exposure",
            type=_word(_EXPOSURES),
        ),
    ] = True


VIEW = "View"  # title of these options
AUTO = "auto"
CHOICES = (AUTO, "pinhole", "cylindrical", "latlon")
_FIELD = separated("HORIZONTALxVERTICAL in degrees, such as 90x60", "x", 2)


@dataclass(frozen=True)
class RectifiedViewOptions(OptionsRecord):
    """What the rectified images show; None is found from what both cameras see.

    projection: one of CHOICES. fov_deg: horizontal and vertical field of view of each image. size: width and height.
    scale: of the focal length. alpha: from 0, valid pixels only, to 1, the whole common field. zero_disparity: one
    centre for both images, so that what is infinitely far has no disparity.
    """

    projection: Annotated[
        str,
        Option(
            "Projection; auto chooses by field of view: pinhole up to about 100°, then cylindrical, then latlon "
            "(equirectangular if one camera is above the other).",
            metavar="NAME",
            group=VIEW,
            choices=CHOICES,
        ),
    ] = AUTO
    fov_deg: Annotated[
        tuple[float, ...] | None,
        Option(
            "Horizontal and vertical field of view; by default what both cameras see.",
            metavar="HxV",
            group=VIEW,
            names="--fov",
            type=_FIELD,
        ),
    ] = None
    size: Annotated[
        tuple[int, int] | None,
        Option(
            "Size of the rectified images; by default by the resolution of the cameras.",
            metavar="WxH",
            group=VIEW,
            type=SIZE,
        ),
    ] = None
    scale: Annotated[
        float | None,
        Option("Factor on the default focal length and size: 0.5 halves both.", metavar="FACTOR", group=VIEW),
    ] = None
    alpha: Annotated[
        float,
        Option(
            "1 (default): keep the common field; 0: crop to pixels that are valid in both images; or between.",
            metavar="0…1",
            group=VIEW,
            least=0,
            most=1,
        ),
    ] = 1.0
    zero_disparity: Annotated[
        bool,
        Option("Same principal point in both images (doffs 0); by default only where that costs little.", group=VIEW),
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scale is not None and not (isfinite(self.scale) and self.scale > 0):
            raise InvalidInput(f"--scale must be positive, found {self.scale:g}")
        if self.scale is not None and self.size is not None:
            raise InvalidInput("--scale and --size exclude each other")
        if self.fov_deg is not None and not all(0 < angle < 360 for angle in self.fov_deg):
            raise InvalidInput("--fov: a field of view is between 0° and 360°")
        if self.size is not None:
            if min(self.size) < 2:
                raise InvalidInput("--size: at least 2x2 pixels")
            require_view(self.size)
