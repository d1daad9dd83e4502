"""Maps of differences over the image of a camera: of two cameras, of a lens over time, of the nearest lens."""

import numpy as np
from matplotlib.figure import FigureBase

from camcal.arrays import Array
from camcal.cameras.directions import grid_pixels
from camcal.cameras.model import Camera
from camcal.cameras.refit import Refit
from camcal.quality.camera_comparison import CameraComparison
from camcal.quality.camera_drift import LensDrift
from camcal.report.figures.figure import COLOUR_MAP, Plot, Theme, panel_height
from camcal.report.figures.image_plane import colour_bar, draw_vectors, image_axes, magnification, scale_of

_GRID = 41  # pixels a side at which a lens is compared
_SIGMAS = 3.0  # of a difference: the line in its map


def camera_difference(found: CameraComparison) -> Plot:
    """Return the map of the difference of two cameras, RMS over the distances, and its directions at the first."""
    figures = [found.figures(index) for index in range(len(found.distances))]
    worst = max(each["compared_worst_px"] or 0.0 for each in figures)
    rms = float(np.sqrt(np.mean([(each["compared_rms_px"] or 0.0) ** 2 for each in figures])))
    return _vector_map(
        "camera_difference",
        (
            "Difference of two cameras",
            "Difference of the projections",
            "difference",
            "from the first camera to the second",
        ),
        f"{rms:.2g} px RMS, at most {worst:.2g} px where both cameras are known",
        (found.u, found.v),
        np.sqrt(np.mean(found.lengths**2, axis=0)),
        found.difference[0],
        found.compared,
        np.sqrt(np.mean(found.sigmas**2, axis=0)),
    )


def lens_drift(found: LensDrift) -> Plot:
    """Return the map of the displacement of projections since a calibration."""
    rms, lengths = found.rms_px, np.linalg.norm(found.moved, axis=1)
    return _vector_map(
        "lens_drift",
        ("Drift since the calibration", "Displacement of the projections since the calibration", "drift", "from then"),
        f"{rms.value:.2g} ± {rms.std:.1g} px RMS, at most {found.worst_px.value:.2g} px where the calibration holds",
        (found.u, found.v),
        lengths,
        found.moved,
        found.inside,
        lengths / np.maximum(found.std, 1e-12),
    )


def refit_difference(before: Camera, found: Refit) -> Plot:
    """Return the map of the difference of the nearest lens of another model."""
    u, v = (np.linspace(0, side - 1, _GRID) for side in before.image_size)
    pixels = grid_pixels(u, v)
    vectors = found.camera.project(before.unproject(pixels).at()).pixels - pixels
    lengths = np.linalg.norm(vectors, axis=1)
    return _vector_map(
        "refit_difference",
        (
            f"The nearest {found.camera.model.name}",
            "Difference of the projections",
            "difference",
            "to the nearest lens",
        ),
        f"{found.rms_px:.2g} px RMS, at most {found.max_px:.2g} px",
        (u, v),
        lengths,
        vectors,
        np.isfinite(lengths) & (lengths <= found.max_px),
        np.zeros(len(lengths)),
    )


def _vector_map(
    name: str,
    words: tuple[str, str, str, str],
    said: str,
    grid: tuple[Array, Array],
    lengths: Array,
    vectors: Array,
    inside: Array,
    sigmas: Array,
) -> Plot:
    """Return the map of lengths (N,) with some of the vectors (N, 2), a dashed line around the pixels inside (N,), and
    another one around less than some standard deviations, sigmas (N,).

    words: the title, what is shown, in one word, and which way its arrows are.
    """
    (u, v), (title, shown, short, arrows) = grid, words
    size, shape = (round(float(u[-1])) + 1, round(float(v[-1])) + 1), (len(v), len(u))
    values, levels = (np.ma.masked_invalid(each.reshape(shape)) for each in (lengths, sigmas))
    pixels = grid_pixels(u, v)
    drawn = np.isfinite(vectors).all(axis=1) & (np.indices(shape) % 2 == 1).all(axis=0).ravel()
    factor = magnification(np.linalg.norm(vectors[drawn], axis=1), size[0])
    contour = levels.count() and levels.min() < _SIGMAS < levels.max()

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = image_axes(figure, size)
        scale = scale_of(values.compressed())
        mesh = axes.pcolormesh(u, v, values, norm=scale, cmap=COLOUR_MAP, shading="gouraud", rasterized=True)
        colour_bar(axes, mesh, f"{short}, px")
        draw_vectors(axes, pixels[drawn], factor * vectors[drawn], theme.series[1], 0.8)
        for levelled, level, style in ((inside.reshape(shape).astype(float), 0.5, "--"), (levels, _SIGMAS, "-")):
            if style == "--" or contour:
                axes.contour(u, v, levelled, levels=[level], colors="white", linestyles=style, linewidths=1.4)
        axes.set_facecolor(theme.faint)
        axes.set_title(f"arrows magnified {factor:g} x", loc="right")

    return Plot(
        name,
        title,
        f"{shown}, {said} (inside the dashed line); arrows {arrows}, magnified {factor:g} x."
        + (f" White line: {_SIGMAS:g} standard deviations." if contour else ""),
        f"Map of the image coloured by the {title[0].lower()}{title[1:]}, {said}.",
        draw,
        panel_height(size),
        dense=True,
    )
