"""Figures of the calibration of a camera: the catalogue, residuals, parameters, lens models."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from camcal import files
from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration, CandidateModel
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.messages import counted
from camcal.quality.projection_uncertainty import ProjectionUncertainty
from camcal.quality.range_uncertainty import range_uncertainty
from camcal.report.figures import image_plane
from camcal.report.figures.board import board_height, board_shape, poses
from camcal.report.figures.figure import DIVERGING_MAP, WIDTH, Plot, Theme, logarithmic_labels
from camcal.report.figures.image_plane import colour_bar

_BINS = 12  # over radius, of as many corners each
_LOW, _HIGH = 0.1, 0.9
_RAYLEIGH = 1.1774  # the median length over the standard deviation of a coordinate
_REACH = 4.5  # standard deviations of the histogram to either side
NAMED = 24  # views with a bar each
_NAME = 22  # characters of a file name
_MAGNITUDE = 8.0  # of the largest error over the smallest: a logarithmic axis
_MOST_NAMES = 24  # parameters with a name at the matrix
_ROOM = 3.0  # times the largest uncertainty: for the legend


def calibration_plots(
    calibration: Calibration,
    uncertainty: ProjectionUncertainty,
    candidates: Sequence[CandidateModel] = (),
    circle: ImageCircle | None = None,
) -> tuple[Plot, ...]:
    """Return the figures of a calibration, in the order in which they are read.

    candidates: lens models that were compared, none where the model was given. circle: the image circle, if any.
    """
    rejected = np.array([corner.pixel for corner in calibration.rejected]) if calibration.rejected else None
    every = (
        image_plane.projection_uncertainty(uncertainty, calibration.camera.image_size, circle),
        _over_distance(calibration, uncertainty),
        image_plane.residual_vectors(calibration),
        residuals_over_radius(calibration),
        residuals_by_view(_rms_of_views(calibration), len(calibration.views)),
        residual_histogram(calibration),
        image_plane.coverage(
            calibration.pixels,
            calibration.camera.image_size,
            len(calibration.used),
            rejected,
            calibration.camera,
            circle,
        ),
        board_shape(calibration.surface),
        board_height(calibration.surface),
        poses(calibration),
        correlations(calibration.camera),
        lens_models(candidates, calibration.camera.model.name),
    )
    return tuple(plot for plot in every if plot is not None)


def _over_distance(calibration: Calibration, uncertainty: ProjectionUncertainty) -> Plot | None:
    """Return the projection uncertainty over the distance, None where that of single cameras is not known."""
    found, at_infinity_px = range_uncertainty(calibration), uncertainty.figures().get("inside_rms_px")
    if found is None or at_infinity_px is None:
        return None
    unit = calibration.board.unit
    distance, least = found.best
    boards = f"{found.near:.2g} to {found.far:.2g} {unit}"
    words = f"least {least:.2g} px at {distance:.2g} {unit}, {at_infinity_px:.2g} px at infinity"

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        axes.axvspan(found.near, found.far, color=theme.faint, alpha=0.35, lw=0, label="boards")
        axes.loglog(found.distances, found.std, color=theme.series[0], lw=1.8, label="1 σ, RMS")
        axes.axhline(at_infinity_px, color=theme.ink, lw=1, ls="--", label="at infinity")
        axes.set_xlim(found.distances[0], found.distances[-1])
        axes.set_ylim(least / 2, _ROOM * float(found.std.max()))
        for axis in (axes.xaxis, axes.yaxis):
            logarithmic_labels(axis)
        axes.set_xlabel(f"distance, {unit}")
        axes.set_ylabel("projection uncertainty, px")
        axes.grid(visible=True)
        axes.legend(loc="upper right", ncols=3, columnspacing=0.8)

    return Plot(
        "uncertainty_over_distance",
        "Projection uncertainty over distance",
        "Standard deviation (1 σ, RMS where corners are) of the projection of points over their distance from the "
        f"camera: {words}. The boards were at {boards} (gray); nearer points depend on where the camera's centre is, "
        "farther ones on the focal length.",
        f"Curve of the projection uncertainty over distance: {words}; boards at {boards}.",
        draw,
        (WIDTH, 3.2),
    )


def residuals_over_radius(calibration: Calibration) -> Plot:
    """Return length and radial part of the residuals over the distance from the principal point."""
    camera = calibration.camera
    away = calibration.pixels - np.array([camera.value("cx"), camera.value("cy")])
    radius = np.linalg.norm(away, axis=1)
    length = np.linalg.norm(calibration.residuals, axis=1)
    outwards = np.sum(calibration.residuals * away, axis=1) / np.maximum(radius, 1e-9)
    bias = max((abs(row[2]) for row in _bin(radius, outwards)), default=0.0)

    def draw(figure: FigureBase, theme: Theme) -> None:
        above, below = figure.subplots(2, 1, sharex=True)
        _draw_over(above, radius, length, theme)
        above.axhline(_RAYLEIGH * calibration.sigma_px, color=theme.ink, lw=1, ls="--", label="expected median")
        above.set_ylabel("length, px")
        above.set_ylim(0, 1.7 * float(np.quantile(length, 0.99)))
        above.legend(loc="upper left", ncols=3, columnspacing=0.8, handlelength=1.2)
        _draw_over(below, radius, outwards, theme)
        below.axhline(0, color=theme.ink, lw=1, ls="--")
        below.set_ylabel("outwards, px")
        most = 1.1 * float(np.quantile(np.abs(outwards), 0.99))
        below.set_ylim(-most, most)
        below.set_xlabel("distance from the principal point, px")

    return Plot(
        "residuals_over_radius",
        "Residuals over radius",
        "Residuals (dots), their median (line) and the band from the 10 % to the 90 % quantile. Above: length, with "
        f"the median that noise of {calibration.sigma_px:.3g} px makes (dashed); below: outward part, whose median is "
        f"at most {bias:.2g} px from zero. A median that leaves the dashed lines shows errors of the lens model.",
        f"Residuals over the distance from the principal point; median outward part at most {bias:.2g} px.",
        draw,
        (WIDTH, 4.4),
        dense=True,
    )


def _bin(radius: Array, values: Array) -> list[tuple[float, float, float, float]]:
    """Return mean radius, low quantile, median and high quantile of bins of as many values each."""
    parts = np.array_split(np.argsort(radius, kind="stable"), min(_BINS, max(len(radius) // 10, 1)))
    return [
        (float(radius[part].mean()), *np.quantile(values[part], [_LOW, 0.5, _HIGH]).tolist())
        for part in parts
        if len(part)
    ]


def _draw_over(axes: Axes, radius: Array, values: Array, theme: Theme) -> None:
    middle, low, median, high = np.array(_bin(radius, values)).T
    axes.plot(radius, values, ".", color=theme.faint, ms=2, rasterized=True)
    axes.fill_between(middle, low, high, color=theme.series[0], alpha=0.25, lw=0, label="10 to 90 %")
    axes.plot(middle, median, color=theme.series[0], lw=1.8, label="median")
    axes.grid(visible=True)


def residuals_by_view(rows: Sequence[tuple[str, float, bool]], images: int) -> Plot:
    """Return the RMS of the residuals of every view, the worst first; of many views, of the worst.

    rows: name, RMS in px and whether it is used, of every view with residuals. images: how many there are in all.
    """
    every = sorted(rows, key=lambda row: (-row[1], row[0]))
    shown = every[:NAMED]
    kept = [rms for _, rms, used in every if used]
    median, rejected = float(np.median(kept)), sum(not used for *_, used in every)
    unused = images - len(every)
    parts = [
        f"the {len(shown)} worst of {len(every)} views" if len(shown) < len(every) else counted(len(every), "view")
    ]
    parts += [f"{rejected} rejected (hatched: RMS of the rejected corners)"] if rejected else []
    parts += [f"{unused} without a usable board are not shown"] if unused else []
    limit = 1.25 * max(kept)

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        draw_ranked(axes, shown, limit, theme)
        axes.axvline(median, color=theme.ink, lw=1, ls="--")
        axes.set_xlabel("RMS of the residuals, px")

    return Plot(
        "residuals_by_view",
        "Residuals by view",
        f"RMS of the residuals of each view, the worst first: {'; '.join(parts)}. Median {median:.3g} px (dashed), "
        f"worst used view {max(kept):.3g} px.",
        f"Bars of the RMS of the residuals by view; median {median:.3g} px, worst {max(kept):.3g} px, "
        f"{counted(rejected, 'view')} rejected.",
        draw,
        ranked_size(len(shown)),
    )


def ranked_views(rows: Sequence[tuple[str, int]]) -> Plot:
    """Return the number of corners of every view, the fewest first; of many views, of those with the fewest."""
    every = [(name, float(count), count > 0) for name, count in sorted(rows, key=lambda row: (row[1], row[0]))]
    shown, counts = every[:NAMED], [count for _, count in rows]
    empty = sum(count == 0 for count in counts)
    words = f"{sum(counts)} corners in {len(rows) - empty} of {counted(len(rows), 'view')}, at most {max(counts)}"
    fewest = f", of the {NAMED} views with the fewest" if len(every) > NAMED else ""

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        draw_ranked(axes, shown, 1.1 * max(*(count for _, count, _ in shown), 1.0), theme)
        axes.set_xlabel("corners, count")

    return Plot(
        "corners_by_view",
        "Corners by view",
        f"Number of corners in each view{fewest}, the fewest first: {words}.",
        f"Bars of the number of corners by view: {words}.",
        draw,
        ranked_size(len(shown)),
    )


def draw_ranked(axes: Axes, shown: Sequence[tuple[str, float, bool]], limit: float, theme: Theme) -> None:
    """Draw a bar for every row of name, value and whether it is used, from the top; values beyond the limit are written
    into their bars.
    """
    for row, (_, value, used) in enumerate(shown):
        colour = theme.series[0] if used else theme.bad
        face, hatch = (colour, None) if used else (theme.paper, "////")
        axes.barh(row, min(value, limit), color=face, edgecolor=colour, hatch=hatch)
        if value > limit:
            axes.text(0.97 * limit, row, f"{value:.3g}", ha="right", va="center", backgroundcolor=theme.paper)
    axes.set_yticks(range(len(shown)), [short_name(name) for name, *_ in shown])
    axes.set_ylim(len(shown) - 0.4, -0.6)
    axes.set_xlim(0, limit)
    axes.locator_params(axis="x", nbins=6)
    axes.grid(visible=True, axis="x")


def ranked_size(rows: int) -> tuple[float, float]:
    """Return the size of a figure of so many bars, inches."""
    return WIDTH, 1.1 + 0.21 * max(rows, 5)


def _rms_of_views(calibration: Calibration) -> list[tuple[str, float, bool]]:
    """Return name, RMS in px and whether it is used, of every view with corners that were compared."""
    found = []
    for view in calibration.views:
        if view.rms_px is not None:
            found.append((view.image, view.rms_px, view.used))
        elif view.rejected:
            distances = np.array([corner.distance for corner in calibration.rejected if corner.image == view.image])
            distances = distances[np.isfinite(distances)]
            found.append((view.image, float(np.sqrt(np.mean(distances**2))) if len(distances) else np.inf, False))
    return found


def short_name(name: str) -> str:
    """Return the last part of a path, its middle left out where it is long."""
    last = files.utf8(name.replace("\\", "/").rsplit("/", 1)[-1]).decode()
    if len(last) <= _NAME:
        return last
    half = (_NAME - 1) // 2
    return f"{last[:half]}…{last[-half:]}"


def residual_histogram(calibration: Calibration) -> Plot:
    """Return the histogram of the coordinates of the residuals with the normal distribution of their noise."""
    sigma = calibration.sigma_px
    values = calibration.residuals.ravel()
    reach = _REACH * max(sigma, 1e-12)
    beyond = int((np.abs(values) > reach).sum())
    ends = np.linspace(-reach, reach, min(61, 2 * round(len(values) ** 0.5 / 2) + 5))
    wide = 100 * float((np.abs(values) > 2 * sigma).mean())

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        axes.hist(values, ends.tolist(), density=True, color=theme.series[0], alpha=0.7, label="residuals")
        fine = np.linspace(-reach, reach, 300)
        normal = np.exp(-0.5 * (fine / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        axes.plot(fine, normal, color=theme.series[1], lw=1.8, label=f"normal, 1 σ = {sigma:.3g} px")
        axes.set_ylim(top=1.3 * max(axes.get_ylim()[1], float(normal.max())))
        axes.set_xlim(-reach, reach)
        axes.set_xlabel("residual of a coordinate, px")
        axes.set_ylabel("density, 1/px")
        axes.grid(visible=True)
        axes.legend(loc="upper center", ncols=2)

    return Plot(
        "residual_histogram",
        "Distribution of the residuals",
        f"Coordinates of the residuals of {counted(len(calibration.residuals), 'corner')} and the normal distribution "
        f"of the estimated noise, 1 σ = {sigma:.3g} px; {wide:.1f} % are beyond 2 σ (normal: 4.6 %), {beyond} beyond "
        f"{_REACH:g} σ are not shown.",
        f"Histogram of residuals beside a normal distribution of {sigma:.3g} px.",
        draw,
        (WIDTH, 3.2),
    )


def correlations(camera: Camera) -> Plot | None:
    """Return the correlation matrix of the free lens parameters, None where fewer than two are, or none is known."""
    names = [name for name in camera.model.parameter_names if name not in camera.fixed]
    if camera.covariance is None or len(names) < 2:
        return None
    index = [camera.model.parameter_names.index(name) for name in names]
    matrix = correlation_matrix(camera.covariance[np.ix_(index, index)])
    return matrix_plot(
        names,
        matrix,
        "lens parameter",
        "Correlations of the lens parameters",
        " Strong correlations are usual: the projection uncertainty accounts for them.",
    )


def matrix_plot(names: Sequence[str], matrix: Array, kind: str, title: str, remark: str = "") -> Plot:
    """Return the correlations (K, K) of named parameters of a kind, such as 'lens parameter', with a remark on them."""
    off = np.abs(matrix - np.eye(len(names)))
    one, other = divmod(int(off.argmax()), len(names))
    strongest = f"{names[one]} and {names[other]}, {matrix[one, other]:+.3f}"
    step = -(-len(names) // _MOST_NAMES)

    def draw(figure: FigureBase, _: Theme) -> None:
        axes = figure.subplots()
        image = axes.imshow(matrix, cmap=DIVERGING_MAP, vmin=-1, vmax=1, interpolation="nearest")
        places = range(0, len(names), step)
        axes.set_xticks(places, names[::step], rotation=90)
        axes.set_yticks(places, names[::step])
        axes.set_xlabel(kind)
        axes.set_ylabel(kind)
        colour_bar(axes, image, "correlation")

    return Plot(
        "correlations",
        title,
        f"Correlation of the errors of {counted(len(names), f'free {kind}')}, -1 to 1; the strongest is that of "
        f"{strongest}.{remark}",
        f"Matrix of correlations of {counted(len(names), kind)}; the strongest is that of {strongest}.",
        draw,
        (WIDTH, 4.2),
    )


def correlation_matrix(covariance: Array) -> Array:
    """Return the correlations (K, K) of a covariance (K, K); 0 with what is certain."""
    std = np.sqrt(np.diag(covariance))
    known = np.where(std > 0, std, np.inf)
    matrix = covariance / np.outer(known, known)
    np.fill_diagonal(matrix, 1.0)
    return np.asarray(np.clip(matrix, -1, 1))


def lens_models(candidates: Sequence[CandidateModel], used: str) -> Plot | None:
    """Return how well the lens models that were compared predict left-out views, None where none were."""
    scored = sorted((own for own in candidates if own.sigma_px is not None), key=lambda own: -own.score)
    if not scored:
        return None
    errors = [own.sigma_px or 0.0 for own in scored]
    failed = [own.name for own in candidates if own.sigma_px is None]
    without = f" Without a result: {', '.join(failed)}." if failed else ""
    words = ", ".join(f"{own.name} {error:.3g} px" for own, error in zip(scored, errors, strict=True))

    def draw(figure: FigureBase, theme: Theme) -> None:
        axes = figure.subplots()
        for row, (own, error) in enumerate(zip(scored, errors, strict=True)):
            colour = theme.series[1] if own.name == used else theme.series[0]
            axes.plot([error], [row], "o", color=colour, ms=8)
            axes.annotate(f"{error:.3g}", (error, row), (7, 0), textcoords="offset points", va="center")
        names = [f"{own.name} (used)" if own.name == used else own.name for own in scored]
        axes.set_yticks(range(len(scored)), names)
        axes.set_ylim(len(scored) - 0.5, -0.5)
        _limit_errors(axes, errors)
        axes.grid(visible=True)
        axes.set_xlabel("prediction error of left-out views, px")

    return Plot(
        "lens_models",
        "Lens models compared",
        f"How far corners of left-out views are from where each lens model predicts them, px, the best first: {words}. "
        f"Used: {used}.{without}",
        f"Prediction errors of {counted(len(scored), 'lens model')}: {words}.",
        draw,
        (WIDTH, 1.1 + 0.3 * max(len(scored), 3)),
    )


def _limit_errors(axes: Axes, errors: Sequence[float]) -> None:
    """Give errors an axis from zero, or a logarithmic one where they are of different magnitude, with room for text."""
    low, high = min(errors), max(errors)
    if low > 0 and high > _MAGNITUDE * low:
        axes.set_xscale("log")
        axes.set_xlim(low / 1.5, high * (high / low) ** 0.3)
        logarithmic_labels(axes.xaxis)
    else:
        axes.set_xlim(0, 1.3 * high or 1.0)
