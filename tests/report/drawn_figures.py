"""What every figure has to be: readable at a width of 400 pixels, with units, captions with numbers, texts apart."""

import re

from matplotlib.legend import Legend
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter
from mpl_toolkits.mplot3d import Axes3D

from camcal.report.figures.figure import LIGHT, drawn

DISPLAYED = 400 / 96  # inches
LEAST_POINTS = 8.0
MARGIN = 1.5  # px of the figure's border and between texts: what anti-aliasing takes
UNITS = re.compile(
    r", (px|m|mm|deg|°|s|%|1|DN|count|electrons|1/px|squares|pixels|um|rad|mm and degrees)$|"
    r", % of the value$| \((1|translation, rotation)\)$"
)
# what is counted or named has no unit
BARE = {"correlation", "lens parameter", "parameter", "corners per cell"}


def texts_of(figure):
    """Return all texts of a figure that are drawn, with their boxes in pixels."""
    renderer = figure.canvas.get_renderer()
    hidden = {id(item) for axes in figure.axes for item in _not_drawn(axes)}
    return [
        (item, item.get_window_extent(renderer))
        for item in figure.findobj(Text)
        if item.get_text().strip() and item.get_visible() and id(item) not in hidden
    ]


def _axes_of(axes):
    return (axes.xaxis, axes.yaxis, *([axes.zaxis] if isinstance(axes, Axes3D) else []))


def _not_drawn(axes):
    """Yield the labels of ticks outside of the limits, and all of axes that are switched off."""
    for axis in _axes_of(axes):
        ticks = {*axis.get_major_ticks(), *axis.get_minor_ticks()}
        drawn_ticks = set(axis._update_ticks()) if axes.axison else set()
        for tick in ticks - drawn_ticks:
            yield from (tick.label1, tick.label2)
        if isinstance(axes, Axes3D):
            yield from (tick.label2 for tick in ticks)
        if not axes.axison:
            yield axis.label


def require_readable(plot, theme=LIGHT):
    """Return a figure drawn in a theme after checking it; raises AssertionError for what is wrong."""
    assert re.search(r"\d", plot.caption), plot.name
    assert plot.caption.endswith("."), plot.caption
    assert plot.alt
    assert "nan" not in plot.caption.split(), plot.caption
    figure = drawn(plot, theme)
    _require_texts_apart(plot, figure)
    _require_legends_apart(plot, figure)
    _require_units(plot, figure)
    return figure


def _require_texts_apart(plot, figure):
    width, height = figure.get_size_inches() * figure.dpi
    shrunk = min(1.0, DISPLAYED / figure.get_size_inches()[0])
    boxes = texts_of(figure)
    assert boxes, plot.name
    for item, box in boxes:
        what = f"{plot.name}: {item.get_text()!r}"
        assert "\\math" not in item.get_text(), what
        assert item.get_fontsize() * shrunk >= LEAST_POINTS - 0.2, what
        inside = box.x0 > -MARGIN and box.y0 > -MARGIN and box.x1 < width + MARGIN and box.y1 < height + MARGIN
        assert inside, f"{what} at {box} is not inside {width} x {height}"
    for index, (item, box) in enumerate(boxes):
        for other, its in boxes[index + 1 :]:
            apart = (
                box.x1 < its.x0 + MARGIN
                or its.x1 < box.x0 + MARGIN
                or box.y1 < its.y0 + MARGIN
                or its.y1 < box.y0 + MARGIN
            )
            assert apart, f"{plot.name}: {item.get_text()!r} and {other.get_text()!r} overlap"


def _require_legends_apart(plot, figure):
    """Texts that are not of a legend are not under it."""
    renderer = figure.canvas.get_renderer()
    for legend in figure.findobj(Legend):
        own = {id(item) for item in legend.findobj(Text)}
        box = legend.get_window_extent(renderer)
        for item, its in texts_of(figure):
            assert id(item) in own or not box.overlaps(its), f"{plot.name}: {item.get_text()!r} is under a legend"


def _require_units(plot, figure):
    for axes in figure.axes:
        if not axes.axison:
            continue
        ticks_named = [
            isinstance(axis.get_major_formatter(), FixedFormatter | FuncFormatter) for axis in (axes.xaxis, axes.yaxis)
        ]
        labels = [axes.get_xlabel(), axes.get_ylabel(), *([axes.get_zlabel()] if isinstance(axes, Axes3D) else [])]
        for place, label in enumerate(labels):
            if not label:
                hidden = place < 2 and (ticks_named[place] or not _numbered(axes, place))
                assert hidden, f"{plot.name}: axis {place} of {axes.get_title()!r} has no label"
            else:
                assert label in BARE or UNITS.search(label), f"{plot.name}: {label!r} has no unit"


def _numbered(axes, place):
    """Return whether an axis shows numbers of its own."""
    axis = (axes.xaxis, axes.yaxis)[place]
    return any(label.get_visible() and label.get_text().strip() for label in axis.get_ticklabels())
