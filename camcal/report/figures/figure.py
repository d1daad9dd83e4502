"""The record of a figure, the two themes, and the bytes of its file.

A figure is drawn for a width of 400 pixels: its text has 10 points on a width of 5 inches, so that it has 8 points
there. Colours are those of Okabe and Ito, which people with any colour vision tell apart, and the maps cividis and
viridis. Source: Okabe & Ito, Color universal design, 2008; Nuñez, Anderton & Renslow, PLoS ONE 13(7), 2018.
"""

import gc
from collections.abc import Callable, Sequence
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.files import stem_of

# with the module that writes them, imported on use: that of PDF takes as long as some figures
_BACKENDS = {".png": "backend_agg", ".svg": "backend_svg", ".pdf": "backend_pdf"}
SUFFIXES = tuple(_BACKENDS)
WIDTH = 5.0  # inches
COLOUR_MAP = "cividis"
DIVERGING_MAP = "PuOr"

_DPI = 160
_FONT = 10.0  # points
_LONGEST = 100  # letters of a title, which may hold a text of a file
_SHORT = 100.0  # of the ends of a logarithmic axis


@dataclass(frozen=True)
class Theme:
    """The colours of a figure, as #rrggbb.

    paper: background. ink: text and axes. faint: grids, what stands behind. series: colours of data, to be taken in
    their order; the first is that of the data themselves. bad: what was rejected or fails. good: what passes.
    """

    name: str
    paper: str
    ink: str
    faint: str
    series: tuple[str, ...]
    bad: str
    good: str


LIGHT = Theme(
    "light",
    paper="#ffffff",
    ink="#1a1a1a",
    faint="#b8b8b8",
    series=("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"),
    bad="#d55e00",
    good="#009e73",
)
DARK = Theme(
    "dark",
    paper="#15181c",
    ink="#e8e8e8",
    faint="#5a6068",
    series=("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#f0e442", "#d55e00"),
    bad="#e69f00",
    good="#2fc49b",
)
THEMES = {theme.name: theme for theme in (LIGHT, DARK)}


@dataclass(frozen=True, eq=False)
class Plot:
    """A figure: what it shows, in words, and how it is drawn.

    name: of its file, without suffix. caption: how to read it, with its numbers and their units. alt: what it shows,
    for those who do not see it. draw: draws it into an empty figure. size: inches. dense: of so many parts that a
    document is better off with pixels than with lines.
    """

    name: str
    title: str
    caption: str
    alt: str
    draw: Callable[[FigureBase, Theme], None]
    size: tuple[float, float] = (WIDTH, 3.6)
    dense: bool = False


def encoded(plot: Plot, suffix: str, theme: Theme = LIGHT, *, titled: bool = True) -> bytes:
    """Return the figure as a file of the type of `suffix`, the same bytes every time; titled: with its title."""
    return encoded_in(plot, suffix, (theme,), titled=titled)[0]


def encoded_in(plot: Plot, suffix: str, themes: Sequence[Theme], *, titled: bool = True) -> list[bytes]:
    """Return the figure in several themes, as `encoded`; without titles it is laid out once, as only colours differ."""
    suffix, result, first = suffix.lower(), [], None
    for theme in themes:
        with mpl.rc_context(_style(plot, theme)):
            figure, stream = _drawn(plot, theme, titled=titled, like=first), BytesIO()
            canvas: Any = import_module(f"matplotlib.backends.{_BACKENDS[suffix]}").FigureCanvas(figure)
            # not savefig, which draws everything twice
            getattr(canvas, f"print_{suffix[1:]}")(stream, metadata=_metadata(plot, suffix))
        result.append(stream.getvalue())
        first = first or figure
    return result


def drawn(plot: Plot, theme: Theme = LIGHT, *, titled: bool = True) -> Figure:
    """Return the figure with the places of all its parts settled."""
    with mpl.rc_context(_style(plot, theme)):
        figure = _drawn(plot, theme, titled=titled)
        figure.draw_without_rendering()
        return figure


def _drawn(plot: Plot, theme: Theme, *, titled: bool, like: Figure | None = None) -> Figure:
    """Return the figure laid out; like: the same in another theme, whose places of axes are taken over, which is all
    of the layout where there is no title.
    """
    free_drawn()
    figure = Figure(figsize=plot.size, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    if titled:
        title = plot.title if len(plot.title) <= _LONGEST else f"{plot.title[:_LONGEST]}…"
        figure.suptitle(title, fontsize=_FONT + 1, fontweight="bold")
    plot.draw(figure, theme)
    if like is None or titled or like.subfigs:
        engine = figure.get_layout_engine()
        assert engine is not None
        # axes of equal lengths along both settle in a second pass
        for _ in range(1 + any(axes.get_aspect() != "auto" for axes in figure.axes)):
            engine.execute(figure)
    else:
        for axes, other in zip(figure.axes, like.axes, strict=True):
            axes.set_position(other.get_position(original=True))
    figure.set_layout_engine("none")
    return figure


def _style(plot: Plot, theme: Theme) -> dict[Any, Any]:
    """Return the settings under which a figure is drawn; ids in an SVG are those of its plot."""
    ink = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color", "axes.titlecolor")
    paper = ("figure.facecolor", "axes.facecolor", "savefig.facecolor", "legend.facecolor")
    return {
        **dict.fromkeys(ink, theme.ink),
        **dict.fromkeys(paper, theme.paper),
        "axes.grid": False,
        "axes.titlesize": _FONT,
        "font.size": _FONT,
        "grid.color": theme.faint,
        "grid.linewidth": 0.5,
        "grid.alpha": 0.5,
        "image.cmap": COLOUR_MAP,
        "legend.edgecolor": theme.faint,
        "legend.fontsize": _FONT - 0.2,
        "legend.framealpha": 0.85,
        "svg.fonttype": "none",
        "text.parse_math": False,  # names of files and columns are not mathematics
        "svg.hashsalt": f"camcal {plot.name} {theme.name}",
    }


def _metadata(plot: Plot, suffix: str) -> dict[str, Any]:
    """Return title and caption as the file's metadata, without a date."""
    if suffix == ".png":
        return {"Software": None, "Title": plot.title, "Description": plot.caption}
    if suffix == ".svg":
        return {"Date": None, "Title": plot.title, "Description": plot.caption}
    return {"CreationDate": None, "Title": plot.title, "Subject": plot.caption}


def require_suffix(path: Path) -> None:
    """Raise InvalidInput unless figures are written as this type of file."""
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"figures are {', '.join(SUFFIXES)}, found {path.suffix or 'no suffix'}", where=str(path))


def panel_height(shape: tuple[float, float]) -> tuple[float, float]:
    """Return the size of a figure, inches, that shows a shape (width, height) beside a colour bar."""
    width, height = shape
    return WIDTH, min(max((WIDTH - 1.5) * height / width + 1.1, 2.6), 6.5)


def beside(name: str, title: str, plots: Sequence[Plot], *, below: bool = False) -> Plot:
    """Return figures side by side as one; below: one below the other."""
    widths, heights = zip(*(plot.size for plot in plots), strict=True)

    def draw(figure: FigureBase, theme: Theme) -> None:
        shape = {"nrows": len(plots), "height_ratios": heights} if below else {"ncols": len(plots)}
        for part, plot in zip(figure.subfigures(**shape), plots, strict=True):
            part.suptitle(plot.title)
            plot.draw(part, theme)

    return Plot(
        name,
        title,
        " ".join(f"{plot.title}: {plot.caption}" for plot in plots),
        " ".join(plot.alt for plot in plots),
        draw,
        (max(widths), sum(heights)) if below else (sum(widths), max(heights)),
        dense=any(plot.dense for plot in plots),
    )


def of_part(plots: Sequence[Plot], part: str) -> tuple[Plot, ...]:
    """Return figures that are about a part of a result, such as one camera: its name is in their names and titles."""
    return tuple(replace(plot, name=name_of_part(plot.name, part), title=f"{plot.title}, {part}") for plot in plots)


def name_of_part(name: str, part: str) -> str:
    """Return the name of a figure that is about a part of a result."""
    return f"{stem_of(part)}_{name}"


def free_drawn() -> None:
    """Free what was drawn before: the parts of a figure refer to one another, and would be kept until there are many.

    Only young objects are looked at, which takes a millisecond.
    """
    gc.collect(1)


def line_colours(theme: Theme) -> ListedColormap:
    """Return the colours of COLOUR_MAP that stand out as thin lines on the paper of a theme."""
    low, high = (0.0, 0.88) if theme is LIGHT else (0.3, 1.0)
    return ListedColormap(mpl.colormaps[COLOUR_MAP](np.linspace(low, high, 256)))


def logarithmic_labels(axis: Axis) -> None:
    """Write the numbers of a logarithmic axis in full: powers of ten, of a short axis 2 and 5 between them as well."""
    low, high = sorted(axis.get_view_interval())
    if high < _SHORT * low:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())
