"""Refinement of marker corners to a hundredth of a pixel, by fitting the pattern to the image.

Which cells of a marker are white is known once it has been read, so that all of its edges say where it is, not its
border alone. The image is modelled as  level + contrast · f(t(u, v)), at most white:  the level a plane, the contrast a
quadratic over the image, and f the tone curve, since gamma acts on what is blurred already and makes white grow:
logit g = logit t + c,  f = g + d g (1 - g) (1 - 2 g).  A parabola lacks the steep shadows of sRGB and enlarges tags by
up to 0.5 % (benchmarks/tag_edges.py).  t = (1 - w) drawing + w halo:  the drawing blurred by a Gaussian, and widely,
for light that strays in lens and paper; w < 0 where a camera sharpens. Cells of both colours tell ink beyond all edges
from the size: corners are those of the drawing as designed. cv2.aruco's ways are off by 0.1 to 0.5 px on the same
markers (benchmarks/markers.py), by 0.3 to 2 px on photographs (benchmarks/tag_prints.py).

The drawing is placed by a homography and by what a lens adds that bends straight lines:
    (x, y) = H(u, v) + Σ kᵢ Bᵢ(u, v)        u, v from -1 to 1 across the marker, x, y in pixels
H is h11 … h32 with h33 = 1. B₁ and B₂ are radial distortion of third and fifth order about the middle of the image,
less what moves the marker's corners, which H does as well. B₃ … B₆ are 1 - u² and 1 - v² along x and along y, times the
marker's side, for what is not quite radial. All of them vanish at the corners.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.solve.descent import Stopping
from camcal.solve.least_squares import Solution, minimise
from camcal.solve.losses import Huber
from camcal.solve.steps import Block, Jacobian, SingularError, Step
from camcal.targets.board_map import apply_homography
from camcal.targets.pattern import MarkerDrawing

BENDS = 6
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # clockwise from the top-left


@dataclass(frozen=True, eq=False)
class Straight:
    """What a homography makes of K places: pixels (K, 2), derivatives (K, 2, 2) by u, v and (K, 2, 8) by h11 … h32."""

    pixels: Array
    by_place: Array
    by_entries: Array

    @property
    def gradients(self) -> Array:
        """The derivatives (K, 2, 2) of u and v by x and y, 1/px."""
        (a, b), (c, d) = self.by_place.transpose(1, 2, 0)
        adjugate = np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2)
        return np.asarray(adjugate / (a * d - b * c)[:, None, None])


def homography(corners: Array) -> Array:
    """Return the entries (8,) of the homography that takes CORNERS to corners (4, 2) px."""
    rows = []
    for (u, v), (x, y) in zip(CORNERS, corners, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -x * u, -x * v], [0, 0, 0, u, v, 1, -y * u, -y * v]]
    return np.asarray(np.linalg.solve(np.array(rows), corners.ravel()))


def straight(entries: Array, places: Array) -> Straight:
    """Return where a homography (8,) puts places (K, 2), as u, v."""
    h, (u, v) = entries, places.T
    one, zero = np.ones_like(u), np.zeros_like(u)
    w = h[6] * u + h[7] * v + 1
    pixels = np.stack([h[0] * u + h[1] * v + h[2], h[3] * u + h[4] * v + h[5]], axis=1) / w[:, None]
    by_place = (h[[0, 1, 3, 4]].reshape(2, 2) - pixels[:, :, None] * h[6:8]) / w[:, None, None]
    x, y = pixels.T
    by_x = np.stack([u, v, one, zero, zero, zero, -x * u, -x * v], axis=1)
    by_y = np.stack([zero, zero, zero, u, v, one, -y * u, -y * v], axis=1)
    return Straight(pixels, by_place, np.stack([by_x, by_y], axis=1) / w[:, None, None])


def places_of(entries: Array, pixels: Array) -> Array:
    """Return the places (K, 2), as u, v, that a homography (8,) puts at pixels (K, 2)."""
    inverse = np.linalg.inv(np.append(entries, 1.0).reshape(3, 3))
    return apply_homography(inverse, pixels)


def bends_of(entries: Array, places: Array, middle: Array, radius: float) -> Array:
    """Return B₁ … B₆ at places (K, 2) near a homography (8,) as (K, 2, 6) px.

    middle: (2,) px, of the image. radius: px, where radial distortion is as large as the distance from there.
    """
    anywhere, corners = straight(entries, places), straight(entries, CORNERS)
    moved = _distortion(corners.pixels - middle, radius).reshape(8, 2)
    followed = anywhere.by_entries @ np.linalg.solve(corners.by_entries.reshape(8, 8), moved)
    radial = _distortion(anywhere.pixels - middle, radius) - followed
    free = np.einsum("kp,xy->kxpy", longest_side(corners.pixels) * (1 - places**2), np.eye(2))
    return np.concatenate([radial, free.reshape(len(places), 2, 4)], axis=2)


def longest_side(corners: Array) -> float:
    """Return the length of the longest side between corners (4, 2)."""
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())


def _distortion(away: Array, radius: float) -> Array:
    """Return radial displacements (K, 2, 2) of third and fifth order, px, of pixels `away` (K, 2) from the middle."""
    square = ((away / radius) ** 2).sum(axis=1)[:, None]
    return np.stack([away * square, away * square**2], axis=2)


_MARGIN = 0.6  # cells around a marker that count; the white there is a cell wide or wider
_BAND_PX = 3.5  # what is farther from an edge says nothing


@dataclass(frozen=True, eq=False)
class Window:
    """Pixels (K, 2) from a marker's middle, their gray values (K,), quadratics 1 x y x² xy y² (K, 6) for the light on
    them, and the bends (K, 2, 6) that a lens may add there.
    """

    pixels: Array
    values: Array
    light: Array
    bends: Array


def marker_window(gray: Array, middle: Array, entries: Array, drawing: MarkerDrawing, most: int) -> Window:
    """Return the pixels of a marker and its margin, of a large one about `most` by its edges.

    gray: (H, W). middle: (2,) px, whole. entries: (8,) of the homography from the drawing to pixels from there.
    """
    corners = straight(entries, CORNERS).pixels
    side = longest_side(corners)
    pixels = _all_over(entries, drawing) if side**2 < most else _by_edges(entries, drawing, side, most)
    size = np.array(gray.shape[::-1])
    pixels = pixels[((pixels + middle >= 0) & (pixels + middle < size)).all(axis=1)]
    column, row = (pixels + middle).astype(np.intp).T
    x, y = pixels.T / side
    places = places_of(entries, pixels)
    bends = bends_of(entries, places, (size - 1) / 2 - middle, float(np.linalg.norm(size)) / 2)
    light = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    return Window(pixels, gray[row, column].astype(np.float64), light, bends)


def _all_over(entries: Array, drawing: MarkerDrawing) -> Array:
    """Return the pixels (K, 2) of a marker and its margin."""
    reach = 1 + 2 * _MARGIN / len(drawing.ink)
    outline = straight(entries, reach * CORNERS).pixels
    low, high = np.floor(outline.min(axis=0)), np.ceil(outline.max(axis=0))
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    return np.asarray(pixels[(np.abs(places_of(entries, pixels)) < reach).all(axis=1)])


def _by_edges(entries: Array, drawing: MarkerDrawing, side: float, most: int) -> Array:
    """Return pixels (K, 2) near the edges of cells, as many by each of them; the same ones every time."""
    starts, ends = drawing.edges
    which = np.arange(most) % len(starts)
    chance = np.random.default_rng(0).random((most, 2))
    along = (ends - starts)[which]
    across = along[:, ::-1] / np.linalg.norm(along, axis=1, keepdims=True)
    band = min(2 * _BAND_PX / side, 2 * _MARGIN / len(drawing.ink))
    places = starts[which] + along * chance[:, [0]] + across * (2 * chance[:, [1]] - 1) * band
    return np.unique(np.rint(straight(entries, places).pixels), axis=0)


# How many pixels are examined and how long, and whether white and halo are modelled: first to come near, then in
# the frame that was found
_PASSES = (
    (300, Stopping(relative_decrease=5e-2, damping=1e-4), False),
    (1200, Stopping(relative_decrease=1e-3, damping=1e-5), True),
)
_ROUNDING = 1 / 12  # gray levels squared
_DRAWN = 3e-7  # rounding errors of the drawing's brightness, 0 to 1
_LEFT_OUT_PX = 0.005  # what the model leaves out moves noise-free corners so far
_LOSS = Huber(2.5)
_HORIZON = 0.05  # least distance of a corner from the horizon, of the middle's
_SHARPEST, _BLURRIEST = -0.5 * np.log(12), 4.0  # logarithms of the blur: of a pixel's own square, and of 55 px
_MAD = 1.4826  # standard deviations of a normal distribution in a median of absolute values

_WHITE, _BEYOND = 255.0, 0.01  # gray level that images end at, and the slope left there, for a fit of 0 and 255 alone
_HALO_PX = (3.0, 8.0)  # standard deviations of two Gaussians: light strays near and far

_ENTRIES, _BENDS, _BLUR, _TONE, _KNEE, _HALO = slice(0, 8), slice(8, 14), 14, 15, 16, 17
_LEVEL, _CONTRAST = slice(18, 21), slice(21, 27)
_COUNT = 27
# What may be expected before the image is seen: of radial distortion at the image's corners, of other bends as a share
# of the marker's side, of the logarithm of the blur (px), of the tone curve's c and d, and of the halo's share
_EXPECTED = np.array([0.0] * BENDS + [np.log(0.85), 0.0, 0.0, 0.0])
_SPREAD = np.array([0.5, 0.5, 1e-3, 1e-3, 1e-3, 1e-3, 0.85, 0.5, 0.3, 0.05])
_EXPECTATIONS = np.arange(8, 18)


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
    parameters[_ENTRIES], parameters[_EXPECTATIONS] = homography(corners - middle), _EXPECTED
    for most, stopping, fine in _PASSES:
        window = marker_window(gray, middle, parameters[_ENTRIES], drawing, most)
        if len(window.values) < 2 * _COUNT:
            return None
        problem, parameters = _MarkerProblem.lit(window, drawing, parameters, fine=fine)
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
    column, row = np.rint(straight(homography(corners), middles).pixels).astype(np.intp).T
    if min(column.min(), row.min()) < 0 or column.max() >= gray.shape[1] or row.max() >= gray.shape[0]:
        return 0.0
    values, ink = (each - each.mean() for each in (gray[row, column].astype(np.float64), drawing.ink.ravel()))
    size = float((values @ values) * (ink @ ink))
    return max(float(values @ ink), 0.0) ** 2 / size if size > 0 else 0.0


@dataclass(frozen=True, eq=False)
class _MarkerProblem:
    """Residuals, in gray levels, of a marker's drawing; the state is (27,): homography, bends, logarithm of the blur
    (that of the pixels' own squares included, which is the least), tone curve (2), share of the halo, plane of the
    level, quadratic of the contrast.

    halo: brightness (K,) of the drawing blurred widely, where it was before the fit, as it varies slowly; None: neither
    halo nor white is modelled.
    variance: gray levels², of the noise, as far as it was known beforehand.
    """

    window: Window
    drawing: MarkerDrawing
    halo: Array | None
    variance: float

    shared = _COUNT
    groups = (0, 0)

    @property
    def rounding(self) -> float:
        """The cost of residuals that are nothing but the rounding of the drawing, whose numbers are float32."""
        return 0.5 * len(self.window.values) * (_DRAWN * float(np.ptp(self.window.values))) ** 2 / self.variance

    @classmethod
    def lit(
        cls, window: Window, drawing: MarkerDrawing, parameters: Array, *, fine: bool
    ) -> tuple["_MarkerProblem", Array]:
        """Return the problem with the noise as it looks from some parameters, and these with the best light.

        Level and contrast are linear: they follow by least squares, whatever the parameters say of them.
        """
        places, placed = _place(window, parameters)
        wide = [drawing.blurred(places, placed.gradients, blur)[0] for blur in _HALO_PX] if fine else []
        halo = np.mean(wide, axis=0) if fine else None
        dark = np.concatenate([parameters[: _LEVEL.start], np.zeros(_COUNT - _LEVEL.start)])
        shades = cls(window, drawing, halo, 1.0).evaluated(dark)[1][:, _LEVEL.start :]
        light = _combination(shades, window.values)
        variance = _variance(shades @ light - window.values)
        return cls(window, drawing, halo, variance), np.concatenate([parameters[: _LEVEL.start], light])

    def evaluated(self, parameters: Array) -> tuple[Array, Array]:
        """Return model less image (K,) and the derivatives (K, 27)."""
        window = self.window
        places, placed = _place(window, parameters)
        value, by_place, by_blur = self.drawing.blurred(places, placed.gradients, np.exp(parameters[_BLUR]))
        level, contrast = window.light[:, :3] @ parameters[_LEVEL], window.light @ parameters[_CONTRAST]
        stray = np.zeros_like(value) if self.halo is None else self.halo - value
        odds = np.exp(parameters[_TONE])
        light = value + parameters[_HALO] * stray
        toned = odds * light / (1 + (odds - 1) * light)
        bow, knee = toned * (1 - toned), parameters[_KNEE]
        steep = contrast * (1 + knee * (1 - 6 * bow))
        shown = toned + knee * bow * (1 - 2 * toned)
        gain = steep * odds / (1 + (odds - 1) * light) ** 2
        direct = (1 - parameters[_HALO]) * gain
        slope = -direct[:, None] * _along(by_place, placed.gradients)
        jacobian = np.empty((len(places), _COUNT))
        jacobian[:, _ENTRIES], jacobian[:, _BENDS] = _along(slope, placed.by_entries), _along(slope, window.bends)
        jacobian[:, _BLUR] = direct * by_blur
        jacobian[:, _TONE] = steep * bow
        jacobian[:, _KNEE] = contrast * bow * (1 - 2 * toned)
        jacobian[:, _HALO] = gain * stray
        jacobian[:, _LEVEL], jacobian[:, _CONTRAST] = window.light[:, :3], window.light * shown[:, None]
        values = level + contrast * shown
        above = (values > _WHITE) & (self.halo is not None and parameters[_BLUR] > _SHARPEST)
        values[above] = _WHITE + _BEYOND * (values[above] - _WHITE)
        jacobian[above] *= _BEYOND
        return values - window.values, jacobian

    def blocks(self, parameters: Array) -> Sequence[Block] | None:
        """Return the image and what is expected beforehand; None for a marker seen edge-on, or a blur beyond reason."""
        horizon = 1 + CORNERS @ parameters[6:8]
        if horizon.min() < _HORIZON or parameters[_BLUR] > _BLURRIEST:
            return None
        residuals, jacobian = self.evaluated(parameters)
        weights = np.full(len(residuals), 1 / self.variance)
        off = (parameters[_EXPECTATIONS] - _EXPECTED) / _SPREAD
        pulls = np.diag(1 / _SPREAD)
        if parameters[_BLUR] <= _SHARPEST and self._sharpens(residuals, jacobian, off):
            # sharper than pixels are: the blur stays, and what would change it is taken out
            off, pulls = np.append(off, 0.0), np.vstack([pulls, pulls[_BLUR - _EXPECTATIONS[0]]])
            jacobian[:, [_BLUR, _HALO]], pulls[_BLUR - _EXPECTATIONS[0]] = 0.0, 0.0
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


def _place(window: Window, parameters: Array) -> tuple[Array, Straight]:
    """Return the places (K, 2), as u, v, that a window shows, and what the homography makes of them."""
    places = places_of(parameters[_ENTRIES], window.pixels - window.bends @ parameters[_BENDS])
    return places, straight(parameters[_ENTRIES], places)


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
    corners = straight(solution.state[_ENTRIES], CORNERS)
    plane = problem.window.light[:, :3]  # about which the variation is explained
    flat = problem.window.values - plane @ _combination(plane, problem.window.values)
    rounding = _ROUNDING * len(flat)
    covariance = solution.factors().shared_covariance()[_ENTRIES, _ENTRIES] * (_variance(residuals) / problem.variance)
    return MarkerFit(
        corners.pixels + middle,
        corners.by_entries @ covariance @ corners.by_entries.swapaxes(1, 2) + _LEFT_OUT_PX**2 * np.eye(2),
        1 - float((residuals @ residuals + rounding) / (flat @ flat + rounding)),
        solution.converged,
        solution.iterations,
    )
