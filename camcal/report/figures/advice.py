"""The views that are worth taking, as pictures of the board in the image."""

import re
from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from camcal.arrays import Array
from camcal.quality.view_advice import Known, SuggestedView, ViewAdvice, rim
from camcal.report.figures.figure import WIDTH, Plot, Theme

_ACROSS = 3  # pictures in a row
_LETTERS = 36  # of a line below a picture
_MOST_DOTS = 4000


def suggested_views(known: Known, advice: ViewAdvice, corners: Array, words: Sequence[str]) -> Plot:
    """Return the pictures of suggested views; corners: (N, 2) px of the views that were seen. words: of each view."""
    rows = -(-len(advice.views) // _ACROSS)
    width, height = known.camera.image_size
    size = 1.6 * WIDTH, rows * (1.6 * WIDTH / _ACROSS * height / width + 0.75) + 0.25
    now, after = advice.std_px, advice.views[-1].std_px
    dots = corners[:: max(len(corners) // _MOST_DOTS, 1)]

    def draw(figure: FigureBase, theme: Theme) -> None:
        panels = figure.subplots(rows, _ACROSS, squeeze=False).ravel()
        for number, (axes, view, text) in enumerate(zip(panels, advice.views, words, strict=False), start=1):
            _draw_view(axes, known, view, f"{number}: {text}", dots, theme)
        for axes in panels[len(advice.views) :]:
            axes.set_axis_off()

    return Plot(
        "suggested_views",
        "Views to take next",
        "The board as the camera will see it in the views that lower the projection uncertainty most, from "
        f"{now:.3g} px to {after:.3g} px (RMS over the image). The thick line is the nearer part, the square dot the "
        "first corner; gray: corners of the views that there are.",
        "; ".join(words),
        draw,
        size,
        dense=True,
    )


def _draw_view(axes: Axes, known: Known, view: SuggestedView, words: str, dots: Array, theme: Theme) -> None:
    width, height = known.camera.image_size
    placed = view.pose.apply(rim(known.surface.board))
    outline = known.camera.project(placed).pixels
    points = known.camera.project(view.pose.apply(known.surface.points())).pixels
    axes.plot(*dots.T, ".", color=theme.faint, ms=1.5, zorder=1)
    axes.fill(*outline.T, facecolor=theme.series[0], alpha=0.15, edgecolor=theme.series[0], lw=1.2, zorder=2)
    axes.plot(*points.T, ".", color=theme.series[0], ms=2.5, zorder=3)
    axes.plot(*points[0], "s", color=theme.series[0], ms=5, zorder=3)
    if view.tilt:  # as much of the outline as a side has, around the nearest corner or on the nearest side
        runs = (np.arange(len(outline))[:, None] + np.arange(len(outline) // 4 + 1)) % len(outline)
        near = runs[np.argmin(placed[runs, 2].mean(axis=1))]
        axes.plot(*outline[near].T, color=theme.series[1], lw=3, zorder=4)
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    label = fill(re.sub(r" (m|squares)$", "\u00a0\\1", words), _LETTERS)
    axes.set_xlabel(f"{label}\n{view.std_px:.3g} px", fontsize=7)
