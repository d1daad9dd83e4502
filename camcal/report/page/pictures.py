"""Plots as pictures of a page: as lines where they are few, as pixels where they are many, in both themes."""

import base64
import re
from collections.abc import Sequence

from camcal.report.figures.figure import DARK, LIGHT, Plot, Theme, encoded
from camcal.report.page.record import Picture

_PX_PER_INCH = 96
_COLOUR = re.compile(rb"#[0-9a-f]{6}\b")


def pictures(plots: Sequence[Plot], prefix: str = "") -> dict[str, Picture]:
    """Return the pictures of plots by the names of these; prefix: of their ids in the page."""
    return {plot.name: _picture(plot, prefix) for plot in plots}


def _picture(plot: Plot, prefix: str) -> Picture:
    suffix = ".png" if plot.dense else ".svg"
    light = encoded(plot, suffix, LIGHT, titled=False)
    # what is drawn as lines differs in its colours only, and need not be laid out twice
    dark = encoded(plot, suffix, DARK, titled=False) if plot.dense else _recoloured(light)
    width, height = (round(side * _PX_PER_INCH) for side in plot.size)
    return Picture(
        f"{prefix}figure-{plot.name}",
        plot.title,
        plot.caption,
        plot.alt,
        light=data_uri(light, suffix),
        dark=data_uri(dark, suffix),
        size=(width, height),
    )


def _recoloured(svg: bytes) -> bytes:
    """Return an SVG of the light theme in the colours of the dark one."""
    pairs = dict(zip(reversed(_colours(LIGHT)), reversed(_colours(DARK)), strict=True))
    return _COLOUR.sub(lambda found: pairs.get(found.group(), found.group()), svg)


def _colours(theme: Theme) -> list[bytes]:
    named = (theme.paper, theme.ink, theme.faint, *theme.series, theme.bad, theme.good)
    return [colour.encode("ascii") for colour in named]


def data_uri(content: bytes, suffix: str) -> str:
    """Return the bytes of an image file as a data URI."""
    kind = {".svg": "svg+xml", ".png": "png", ".jpg": "jpeg"}[suffix]
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"
