"""Which pairs are none and which maps are worth nothing: the limits, all of them, and what is said beyond them."""

from typing import NamedTuple


class Limits(NamedTuple):
    """What a pair and its map must keep to.

    rows_px: largest amount that rows may be off, pixels; a plane over the image puts so much right. matched: least
    share of the pixels that are matched and not filled. wrong_side: largest share of the features that may stand on the
    wrong side of what is infinitely far, from `sideways_px` pixels on. alike: largest share of the features that may be
    at one place in both images, to `parallax_px` pixels; two real images scatter more, whatever their distance.
    """

    rows_px: float = 5.0
    matched: float = 0.15
    wrong_side: float = 0.95
    sideways_px: float = 0.5
    alike: float = 0.95
    parallax_px: float = 0.25


LIMITS = Limits()


def too_few(matched: float) -> str | None:
    """Return what is said of a map with such a share of matched pixels, None if they are enough."""
    if matched >= LIMITS.matched:
        return None
    return (
        f"{100 * matched:.1f} % of the pixels are matched, fewer than {100 * LIMITS.matched:g} %: do both images show "
        "the same scene, are they rectified, and is the range right?"
    )
