"""Words that messages about views share."""

from collections.abc import Sequence

_NAMED = 5  # images in a sentence


def px_words(distance: float) -> str:
    """Return a distance in pixels at two digits or more, never in exponents."""
    return f"{distance:.0f} px" if distance >= 10 else f"{distance:.2g} px"


def names_of(images: Sequence[str], most: int = _NAMED) -> str:
    """Return the names of images in a sentence, `most` of them."""
    more = f" and {len(images) - most} more" if len(images) > most else ""
    return ", ".join(images[:most]) + more
