"""Figures of a disparity map, and of one against its truth: histogram of errors, their map, the bad pixels."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.report.figures import image_plane
from camcal.report.figures.figure import COLOUR_MAP, WIDTH, Plot, Theme, panel_height
from camcal.stereo.truth import THRESHOLDS

ERROR_PLOTS = ("error_histogram", "error_map", "bad_pixels")  # their names, in the order of `disparity_error_plots`

_REACH = 4.0  # px of the histogram to either side
_BINS = 81
_MOST = 1200  # px of a side that are drawn
_LEVELS = (0.0, 0.1, 0.25, *THRESHOLDS, 8.0)


@dataclass(frozen=True, eq=False)
class DisparityErrors:
    """errors: disparity minus truth (H, W), px, NaN without a disparity. known, visible: (H, W) which have a truth,
    and which both cameras see.
    """

    errors: Array
    known: Array
    visible: Array

    @property
    def counted(self) -> Array:
        """The errors (N,) of pixels that both cameras see and that have truth and disparity, px."""
        values = self.errors[self.known & self.visible]
        return np.asarray(values[np.isfinite(values)])

    def bad_percent(self, threshold: float) -> float:
        """Return how many percent of the pixels that both cameras see are off by more, or have no disparity."""
        chosen = self.known & self.visible
        good = np.abs(self.errors[chosen]) <= threshold
        return 100 * (1 - float(good.mean())) if chosen.any() else float("nan")


def disparity_error_plots(found: DisparityErrors) -> tuple[Plot, ...]:
    """Return the histogram of errors, their map, and the map of bad pixels."""
    return error_histogram(found), error_map(found), bad_pixels(found)


def disparity_map(values: Array) -> Plot:
    """Return a disparity map (H, W), px, NaN without a match."""
    known = values[np.isfinite(values)]
    share = 100 * known.size / max(values.size, 1)
    scale = image_plane.scale_of(known)
    words = f"{share:.1f} % of the pixels matched"
    if known.size:
        words = f"{float(known.min()):.4g} to {float(known.max()):.4g} px, {words}"
    shown, extent = _thin(values), (-0.5, values.shape[1] - 0.5, values.shape[0] - 0.5, -0.5)

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = _image_axes(figure)
        image = axes.imshow(shown, COLOUR_MAP, scale, interpolation="nearest", extent=extent)
        axes.set_facecolor(theme.faint)
        image_plane.colour_bar(axes, image, "disparity, px")

    return Plot(
        "disparity",
        "Disparity",
        f"Disparity (left minus right column), larger is nearer: {words}; gray: no match.",
        f"Map of disparities, {words}.",
        draw,
        panel_height((values.shape[1], values.shape[0])),
        dense=True,
    )


def error_histogram(found: DisparityErrors) -> Plot:
    """Return the histogram of disparity minus truth."""
    values = found.counted
    shares, ends = np.histogram(values, np.linspace(-_REACH, _REACH, _BINS + 1))
    shares = 100 * shares / max(len(values), 1)
    median = float(np.median(values)) if len(values) else 0.0
    words = f"median {median:+.3g} px, {shares.sum():.1f} % within {_REACH:g} px, of {len(values)} pixels"

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        axes.stairs(shares, ends, fill=True, color=theme.series[0])
        axes.axvline(0, color=theme.ink, lw=1)
        axes.axvline(median, color=theme.series[1], lw=1.5, ls="--", label=f"median {median:+.3g} px")
        if len(values):
            axes.set_yscale("log")
            axes.set_ylim(shares[shares > 0].min() / 2, 8 * shares.max())
        axes.set_xlim(-_REACH, _REACH)
        axes.set_xlabel("disparity minus truth, px")
        axes.set_ylabel("pixels, %")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.grid(visible=True)
        axes.legend(loc="upper left")

    return Plot(
        "error_histogram",
        "Errors of the disparity",
        f"Disparity minus truth of the pixels that both cameras see, px; logarithmic counts in percent: {words}.",
        f"Histogram of disparity errors: {words}.",
        draw,
        (WIDTH, 3.2),
    )


def error_map(found: DisparityErrors) -> Plot:
    """Return the errors over the image."""
    values = found.counted
    mean = float(np.mean(np.abs(values))) if len(values) else 0.0
    shown, extent = _thin(np.where(found.known, np.abs(found.errors), np.nan)), _extent(found)

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = _image_axes(figure)
        scale = BoundaryNorm(_LEVELS, 256, extend="max")
        image = axes.imshow(shown, COLOUR_MAP, scale, interpolation="nearest", extent=extent)
        axes.set_facecolor(theme.faint)
        image_plane.colour_bar(axes, image, "error, px")

    return Plot(
        "error_map",
        "Errors over the image",
        f"Distance of the disparity from the truth, px, {mean:.3g} px on average of the {len(values)} pixels that both "
        "cameras see; gray: no disparity or no truth.",
        f"Map of disparity errors, {mean:.3g} px on average.",
        draw,
        panel_height((found.errors.shape[1], found.errors.shape[0])),
        dense=True,
    )


def bad_pixels(found: DisparityErrors, threshold: float = 2.0) -> Plot:
    """Return where the disparity is off by more than a threshold (px) or missing, and what one camera alone sees."""
    share = found.bad_percent(threshold)
    kinds = np.zeros(found.errors.shape, np.uint8)
    with np.errstate(invalid="ignore"):
        kinds[np.abs(found.errors) > threshold] = 1
    kinds[~np.isfinite(found.errors)] = 2
    kinds[~found.visible] = 3
    kinds[~found.known] = 4
    shown, extent = _thin(kinds), _extent(found)
    words = (f"within {threshold:g} px", f"beyond {threshold:g} px", "no disparity", "occluded", "no truth")

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = _image_axes(figure)
        colours = [theme.paper, theme.bad, theme.series[0], theme.faint, theme.ink]
        shades = ListedColormap(colours)
        axes.imshow(shown, shades, vmin=0, vmax=4, interpolation="nearest", extent=extent)
        handles = [Patch(fc=colour, ec=theme.ink, label=word) for colour, word in zip(colours, words, strict=True)]
        figure.legend(handles=handles, loc="outside lower center", ncols=3, columnspacing=0.8)

    width, height = panel_height((found.errors.shape[1], found.errors.shape[0]))
    return Plot(
        "bad_pixels",
        "Bad pixels",
        f"Pixels whose disparity is off by more than {threshold:g} px or missing: {share:.2f} % of those that both "
        f"cameras see (bad{threshold:g}).",
        f"Map of bad pixels, {share:.2f} % of what both cameras see.",
        draw,
        (width, height + 0.8),
        dense=True,
    )


def _image_axes(figure: FigureBase) -> Axes:
    axes: Axes = figure.subplots()
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")
    axes.locator_params(nbins=6)
    return axes


def _thin(image: Array) -> Array:
    """Return a copy of every n-th pixel of an image (H, W), no more than can be shown: figures keep no whole image."""
    step = -(-max(image.shape) // _MOST)
    return image[::step, ::step].copy()


def _extent(found: DisparityErrors) -> tuple[float, float, float, float]:
    height, width = found.errors.shape
    return -0.5, width - 0.5, height - 0.5, -0.5
