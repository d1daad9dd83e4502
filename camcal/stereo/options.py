"""Options of stereo matching."""

from dataclasses import dataclass
from typing import Annotated

from camcal.options import Option, OptionsRecord, ValueType
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
