"""The limits of pairs that can be matched and of maps that can be used, and the failures beyond them."""

from typing import NamedTuple

from camcal.messages import Message


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


def too_few(matched: float, *, by_rig: bool = False) -> tuple[Message, ...]:
    """Return the failure of a map with such a share of matched pixels, none if they are enough.

    by_rig: the images were rectified by a rig file, so that this and their order may be wrong.
    """
    if matched >= LIMITS.matched:
        return ()
    text = (
        f"{100 * matched:.1f} % of the pixels matched (limit {100 * LIMITS.matched:g} %): check that both images show "
    )
    if by_rig:
        text += "the same scene, that LEFT and RIGHT are not exchanged, that the rig file is theirs, and the --range"
    else:
        text += "the same scene and are rectified, and the --range"
    return (Message("few_matches", text, {"matched": matched, "limit": LIMITS.matched}),)
