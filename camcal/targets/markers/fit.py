"""Corners of a marker to a hundredth of a pixel: the marker's own drawing fitted to the image.

Which cells of a marker are white is known once it has been read, so that all of its edges say where it is, not its
border alone. The image is modelled as  level + contrast · f(drawing(u, v)):  the drawing blurred by a Gaussian and
placed as in marker_map, the level a plane, the contrast a quadratic over the image, and f(t) = t + c t (1 - t), since
gamma, which acts on what is blurred already, makes white grow. cv2.aruco's ways are off by 0.1 to 0.5 px on the same
markers (benchmarks/markers.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import Solution, minimise
from camcal.solve.losses import Huber
from camcal.solve.steps import Block, Jacobian, SingularError, Step
from camcal.targets.markers import map as marker_map
from camcal.targets.markers.drawing import MarkerDrawing
from camcal.targets.markers.window import Window, look

# How many pixels are looked at and how long: first to come near, then in the frame that was found
_PASSES = (
    (300, Stopping(relative_decrease=5e-2, damping=1e-4)),
    (1200, Stopping(relative_decrease=1e-3, damping=1e-5)),
)
_ROUNDING = 1 / 12  # gray levels squared
_DRAWN = 3e-7  # rounding errors of the drawing's brightness, 0 to 1
_LEFT_OUT_PX = 0.005  # what the model leaves out moves noise-free corners so far
_LOSS = Huber(2.5)
_HORIZON = 0.05  # least distance of a corner from the horizon, of the middle's
_SHARPEST, _BLURRIEST = -0.5 * np.log(12), 4.0  # logarithms of the blur: of a pixel's own square, and of 55 px
_MAD = 1.4826  # standard deviations of a normal distribution in a median of absolute values

_ENTRIES, _BENDS, _BLUR, _TONE = slice(0, 8), slice(8, 14), 14, 15
_LEVEL, _CONTRAST = slice(16, 19), slice(19, 25)
_COUNT = 25
# What may be expected before the image is seen: of radial distortion at the image's corners, of other bends as a share
# of the marker's side, of the logarithm of the blur (px), and of the tone curve
_EXPECTED = np.array([0.0] * marker_map.BENDS + [np.log(0.85), 0.0])
_SPREAD = np.array([0.5, 0.5, 1e-3, 1e-3, 1e-3, 1e-3, 0.85, 0.5])
_EXPECTATIONS = np.arange(8, 16)


@dataclass(frozen=True, eq=False)
class MarkerFit:
    """Corners (4, 2) px, clockwise from the top-left of the drawing, and their covariance (4, 2, 2) px².

    agreement: share of the image's variation that the drawing explains. settled: whether the iteration came to rest.
    iterations: of the last pass.
    """

    corners: Array
    covariance: Array
    agreement: float
    settled: bool
    iterations: int = 0


def fit_marker(gray: Array, corners: Array, drawing: MarkerDrawing) -> MarkerFit | None:
    """Return a marker fitted to an image, None if what is in there does not fix it.

    gray: (H, W). corners: (4, 2) px, the start, clockwise from the top-left of the drawing, good to a cell's half.
    """
    middle = np.rint(corners.mean(axis=0))
    parameters = np.zeros(_COUNT)
    parameters[_ENTRIES], parameters[_EXPECTATIONS] = marker_map.homography(corners - middle), _EXPECTED
    for most, stopping in _PASSES:
        window = look(gray, middle, parameters[_ENTRIES], drawing, most)
        if len(window.values) < 2 * _COUNT:
            return None
        problem, parameters = _MarkerProblem.lit(window, drawing, parameters)
        solution = minimise(problem, parameters, replace(stopping, rounding=problem.rounding))
        parameters = solution.state
    try:
        return _result(problem, solution, middle)
    except SingularError:
        return None


def looks_alike(gray: Array, corners: Array, drawing: MarkerDrawing) -> float:
    """Return the share of the variation between the middles of cells that a drawing explains, without any fit.

    Arguments as of `fit_marker`; 0 where a cell is outside the image, or where the image is a negative.
    """
    lines = drawing.lines
    middles = np.stack(np.meshgrid(*[(lines[1:] + lines[:-1]) / 2] * 2), axis=-1).reshape(-1, 2)
    column, row = np.rint(marker_map.straight(marker_map.homography(corners), middles).pixels).astype(np.intp).T
    if min(column.min(), row.min()) < 0 or column.max() >= gray.shape[1] or row.max() >= gray.shape[0]:
        return 0.0
    values, ink = (each - each.mean() for each in (gray[row, column].astype(np.float64), drawing.ink.ravel()))
    size = float((values @ values) * (ink @ ink))
    return max(float(values @ ink), 0.0) ** 2 / size if size > 0 else 0.0


@dataclass(frozen=True, eq=False)
class _MarkerProblem:
    """Residuals, in gray levels, of a marker's drawing; the state is (25,): homography, bends, logarithm of the blur
    (that of the pixels' own squares included, which is the least), tone curve, plane of the level, quadratic of the
    contrast.

    variance: gray levels², of the noise, as far as it was known beforehand.
    """

    window: Window
    drawing: MarkerDrawing
    variance: float

    shared = _COUNT
    groups = (0, 0)

    @property
    def rounding(self) -> float:
        """The cost of residuals that are nothing but the rounding of the drawing, whose numbers are float32."""
        return 0.5 * len(self.window.values) * (_DRAWN * float(np.ptp(self.window.values))) ** 2 / self.variance

    @classmethod
    def lit(cls, window: Window, drawing: MarkerDrawing, parameters: Array) -> tuple["_MarkerProblem", Array]:
        """Return the problem with the noise as it looks from some parameters, and these with the best light.

        Level and contrast are linear: they follow by least squares, whatever the parameters say of them.
        """
        shades = cls(window, drawing, 1.0).evaluated(parameters)[1][:, _LEVEL.start :]
        light = _combination(shades, window.values)
        variance = _variance(shades @ light - window.values)
        return cls(window, drawing, variance), np.concatenate([parameters[: _LEVEL.start], light])

    def evaluated(self, parameters: Array) -> tuple[Array, Array]:
        """Return model less image (K,) and the derivatives (K, 25)."""
        window, entries = self.window, parameters[_ENTRIES]
        places = marker_map.places_of(entries, window.pixels - window.bends @ parameters[_BENDS])
        placed = marker_map.straight(entries, places)
        seen = self.drawing.blurred(places, placed.gradients, np.exp(parameters[_BLUR]))
        level, contrast = window.light[:, :3] @ parameters[_LEVEL], window.light @ parameters[_CONTRAST]
        bow = seen.value * (1 - seen.value)
        shown = seen.value + parameters[_TONE] * bow
        gain = contrast * (1 + parameters[_TONE] * (1 - 2 * seen.value))
        slope = -gain[:, None] * _along(seen.slope, placed.gradients)
        jacobian = np.empty((len(places), _COUNT))
        jacobian[:, _ENTRIES], jacobian[:, _BENDS] = _along(slope, placed.by_entries), _along(slope, window.bends)
        jacobian[:, _BLUR] = gain * seen.by_blur
        jacobian[:, _TONE] = contrast * bow
        jacobian[:, _LEVEL], jacobian[:, _CONTRAST] = window.light[:, :3], window.light * shown[:, None]
        return level + contrast * shown - window.values, jacobian

    def blocks(self, parameters: Array) -> Sequence[Block] | None:
        """Return the image and what is expected beforehand; None for a marker seen edge-on, or a blur beyond reason."""
        horizon = 1 + marker_map.CORNERS @ parameters[6:8]
        if horizon.min() < _HORIZON or parameters[_BLUR] > _BLURRIEST:
            return None
        residuals, jacobian = self.evaluated(parameters)
        weights = np.full(len(residuals), 1 / self.variance)
        off = (parameters[_EXPECTATIONS] - _EXPECTED) / _SPREAD
        pulls = np.diag(1 / _SPREAD)
        if parameters[_BLUR] <= _SHARPEST and self._sharpens(residuals, jacobian, off):
            # sharper than pixels are: the blur stays, and what would change it is taken out
            off, pulls = np.append(off, 0.0), np.vstack([pulls, pulls[_BLUR - _EXPECTATIONS[0]]])
            jacobian[:, _BLUR], pulls[_BLUR - _EXPECTATIONS[0]] = 0.0, 0.0
        image, expected = Jacobian(jacobian[:, None], np.arange(_COUNT)), Jacobian(pulls[:, None], _EXPECTATIONS)
        return [Block(residuals[:, None], (image,), weights=weights, loss=_LOSS), Block(off[:, None], (expected,))]

    def _sharpens(self, residuals: Array, jacobian: Array, off: Array) -> bool:
        """Return whether less blur would lower the cost."""
        weights = _LOSS.weight(residuals**2 / self.variance) / self.variance
        place = _BLUR - _EXPECTATIONS[0]
        return bool((weights * residuals) @ jacobian[:, _BLUR] + off[place] / _SPREAD[place] > 0)

    def retract(self, parameters: Array, step: Step) -> Array:
        """Return the parameters moved by a step, the blur no sharper than pixels are."""
        moved = parameters + step.shared
        moved[_BLUR] = max(moved[_BLUR], _SHARPEST)
        return np.asarray(moved)


def _combination(columns: Array, values: Array) -> Array:
    """Return the combination (C,) of columns (K, C) of size one that is nearest to values (K,)."""
    return np.asarray(np.linalg.lstsq(columns.T @ columns, columns.T @ values, rcond=None)[0])


def _along(slopes: Array, directions: Array) -> Array:
    """Return slopes (K, 2) times directions (K, 2, L) as (K, L)."""
    return np.asarray(slopes[:, [0]] * directions[:, 0] + slopes[:, [1]] * directions[:, 1])


def _variance(residuals: Array) -> float:
    """Return the variance of the noise in residuals (K,), outliers among them or not."""
    return float((_MAD * np.median(np.abs(residuals))) ** 2) * len(residuals) / (len(residuals) - _COUNT) + _ROUNDING


def _result(problem: _MarkerProblem, solution: Solution[Array], middle: Array) -> MarkerFit:
    residuals = problem.evaluated(solution.state)[0]
    corners = marker_map.straight(solution.state[_ENTRIES], marker_map.CORNERS)
    covariance = solution.factors().shared_covariance()[_ENTRIES, _ENTRIES] * (_variance(residuals) / problem.variance)
    return MarkerFit(
        corners.pixels + middle,
        corners.by_entries @ covariance @ corners.by_entries.swapaxes(1, 2) + _LEFT_OUT_PX**2 * np.eye(2),
        _agreement(problem.window, residuals),
        solution.converged,
        solution.iterations,
    )


def _agreement(window: Window, residuals: Array) -> float:
    """Return the share of the variation about a plane that is explained."""
    plane = window.light[:, :3]
    flat = window.values - plane @ _combination(plane, window.values)
    rounding = _ROUNDING * len(flat)
    return 1 - float((residuals @ residuals + rounding) / (flat @ flat + rounding))
