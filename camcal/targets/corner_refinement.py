"""Corner refinement: a model of two crossing edges fitted to the cell of every corner.

Around a corner the image is modelled as
    (1 + g · (x, y)) · (level + contrast · T(f)),   f the crossing and T the tone curve,
with both edges' places, directions and blurs, and the gradient g of the light: eleven unknowns a corner. The edges may
bend as a lens bends them, by a curvature that is given. Only pixels by the edges are examined, each counted with the
nearer one, and none that the next edges reach. All corners are fitted at once, by steps in offsets and angles of the
edges, in which the unknowns hardly depend on each other.

With d₁, d₂ the signed distances to two edges and s the blur, a crossing resembles  E[sign(d₁ + ε₁) sign(d₂ + ε₂)],
ε normal of standard deviation s and correlated by the cosine ρ of the angle between the edges' normals:
    erf(z₁ / √2) erf(z₂ / √2) + 4 Σ ρᵏ / k! · φ⁽ᵏ⁻¹⁾(z₁) φ⁽ᵏ⁻¹⁾(z₂),   z = d / s,  φ the normal density
(the tetrachoric series, Pearson 1900). It is the same on opposite sides of the corner, so terms left out move nothing.

The next edges may be so near that the blur brings them in. A row of squares is sgn(u) - sgn(u - h) - sgn(u + h'), so
the picture is then a sum of nine crossings: of an edge and its two neighbours with the other edge and its neighbours.
At the border of the pattern dark squares end and bright ones do not: the squares that would be dark beyond it are added
as bright ones.

The curve that gamma lays over what is blurred already is one unknown,
    T(f; β) = ((1 + β f)^g - 1) / (g β)  with g = 1 / 2.2 and T(f; 0) = f.
What is between -1 and 1 as light lies in 1 + β f, β the contrast of the light; other gammas have curves close to those
of this one with another β. A parabola would leave two parts in a hundred of the contrast, which draw corners whose
edges lie along the rows of pixels.
"""

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.solve.descent import Stopping
from camcal.solve.independent import Minima, Models, Trial, minimise_each
from camcal.targets.corner_cells import LONGEST_PX, Beside, Cells, CellWindow, sample_cells

_SIGNS = np.array([-1.0, 1.0, -1.0], np.float32)  # of the edge before, the edge itself, the edge after

CheckerPicture = tuple[Array, tuple[Array, Array], tuple[Array, Array]]


"""The picture (N, K), its derivatives by the scaled distances from both edges, and by the logarithms of both blurs with
a minus sign: the sums of z ∂/∂z over an edge and its neighbours.
"""


def alone(first: Array, second: Array, correlation: Array) -> CheckerPicture:
    """Return the picture of two edges at scaled distances (N, K) without neighbours; correlation: see `crossing`."""
    value, by_first, by_second = crossing(first, second, correlation)
    return value, (by_first, by_second), (first * by_first, second * by_second)


def crowded(first: Array, second: Array, correlation: Array, border: Array, bright: Array) -> CheckerPicture:
    """Return the picture of two edges and their neighbours.

    first, second: (3, N, K) scaled distances from the edge on the right, the edge itself and the one on the left.
    correlation: see `crossing`. border: (N, 2, 2) whether an edge on the right or left is the border of the pattern.
    bright: (N, 1) the sign of the picture in bright squares.
    """
    seen = [[crossing(one, other, correlation) for other in second] for one in first]
    both, single, constant = _weights(border, bright.astype(np.float32))
    value = np.broadcast_to(constant, first[0].shape).copy()
    slopes = [[np.zeros_like(value) for _ in range(3)] for _ in range(2)]
    for i in range(3):
        for j in range(3):
            share = both[:, i, j, None]
            crossed, by_first, by_second = seen[i][j]
            value += share * crossed
            slopes[0][i] += share * by_first
            slopes[1][j] += share * by_second
    for family, places in enumerate((first, second)):
        for i, distance in enumerate(places):
            side, density = edge(distance)
            share = single[:, family, i, None]
            value += share * side
            slopes[family][i] += share * (2 * density)
    by_blur_1, by_blur_2 = (
        (places * np.stack(slopes[family])).sum(axis=0) for family, places in enumerate((first, second))
    )
    return value, (slopes[0][1], slopes[1][1]), (by_blur_1, by_blur_2)


def _weights(border: Array, bright: Array) -> tuple[Array, Array, Array]:
    """Return the weights of crossings (N, 3, 3), of single edges (N, 2, 3), and the constant (N, 1).

    With c the sign of bright squares and w the other edges' row of squares, a border on the left adds
    c/2 · E[(1 + sgn(u - h)) (1 + c w)], one on the right c/2 · E[(1 - sgn(u + h)) (1 - c w)].
    """
    count = len(border)
    both = np.tile(np.outer(_SIGNS, _SIGNS), (count, 1, 1))
    single, constant = np.zeros((count, 2, 3), np.float32), np.zeros((count, 1), np.float32)
    for family in (0, 1):
        rows = both if family == 0 else both.swapaxes(1, 2)
        for index, sign in ((0, -1), (2, 1)):
            here = border[:, family, index // 2].astype(np.float32)[:, None]
            rows[:, index] += here / 2 * _SIGNS
            single[:, 1 - family] += sign * here / 2 * _SIGNS
            single[:, family, index] += sign * (here * bright / 2)[:, 0]
            constant += here * bright / 2
    return both.astype(np.float32), single, constant


PIXEL_VARIANCE = 1 / 12  # of a pixel's own square, which blurs every picture
_ROOT_HALF = np.float32(np.sqrt(0.5))
_DENSITY = np.float32(1 / np.sqrt(2 * np.pi))
_HASTINGS = np.array([0.3275911, 0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429], np.float32)
_FAR = np.float32(20.0)
_STRAIGHT = 0.02  # |ρ| below which edges cross at right angles as far as can be seen


def edge(distance: Array) -> tuple[Array, Array]:
    """Return the picture erf(z / √2) of one edge at scaled distances z, and the normal density at z.

    To 5e-7, which is less than single precision keeps of a gray level, in half the time of scipy.special.erf.
    Source: Abramowitz and Stegun 1964, 7.1.26.
    """
    scaled = np.abs(distance)
    scaled *= _ROOT_HALF
    fall = np.exp(-scaled * scaled)
    scaled *= _HASTINGS[0]
    scaled += 1
    share = np.reciprocal(scaled, out=scaled)
    series = share * _HASTINGS[-1]
    for coefficient in _HASTINGS[-2:0:-1]:
        series += coefficient
        series *= share
    series *= fall
    np.subtract(1, series, out=series)
    fall *= _DENSITY
    return np.copysign(series, distance), fall


def crossing(first: Array, second: Array, correlation: Array) -> tuple[Array, Array, Array]:
    """Return the picture at scaled distances z₁, z₂ (N, K) from the edges of N corners, and its derivatives by both.

    The picture lies between -1 and 1. correlation: (N, 1) cosine of the angle between the normals of the two edges.
    """
    (side_1, density_1), (side_2, density_2) = edge(first), edge(second)
    value = side_1 * side_2
    by_first, by_second = 2 * density_1 * side_2, 2 * density_2 * side_1
    if np.abs(correlation).max() < _STRAIGHT:
        return value, by_first, by_second
    both = density_1 * density_2
    first, second = np.clip(first, -_FAR, _FAR), np.clip(second, -_FAR, _FAR)  # where `both` is nought
    bow_1, bow_2 = first * first - 1, second * second - 1
    one, two, three = (4 * correlation**k / divisor for k, divisor in ((1, 1), (2, 2), (3, 6)))
    value += both * (one + two * first * second + three * bow_1 * bow_2)
    by_first += both * (first * (three * (2 - bow_1) * bow_2 - one) - two * second * bow_1)
    by_second += both * (second * (three * (2 - bow_2) * bow_1 - one) - two * first * bow_2)
    return value, by_first, by_second


STRONGEST = 0.97  # |β|, beyond which black has no light at all
_GAMMA = np.float32(1 / 2.2)
_NEAR = np.float32(0.01)  # |β| below which the series is as good in single precision
_LEAST = np.float32(0.01)  # of 1 + β f, where the picture's series has run past -1 or 1


def apply_tone(picture: Array, tone: Array) -> tuple[Array, Array, Array]:
    """Return pictures (N, K) between -1 and 1 under curves with β = tone (N, 1), and the derivatives by both."""
    curved = (np.abs(tone) > _NEAR)[:, 0]
    first, second = (_GAMMA - 1) * picture, (_GAMMA - 1) * (_GAMMA - 2) * picture**2
    value = picture * (1 + tone * (first / 2 + tone * second / 6))
    by_picture = 1 + tone * (first + tone * second / 2)
    by_tone = picture * (first / 2 + tone * second / 3)
    if curved.any():
        some, beta = picture[curved], tone[curved]
        light = np.maximum(1 + beta * some, _LEAST)
        slope = light ** (_GAMMA - 1)
        value[curved] = (slope * light - 1) / (_GAMMA * beta)
        by_picture[curved] = slope
        by_tone[curved] = (some * slope - value[curved]) / beta
    return value, by_picture, by_tone


ROUNDING = 1 / 12  # gray levels² of whole numbers
_BLUR_PX = (0.29, 6.3)  # a pixel's own square is the least; without it an edge between two rows could be anywhere there
# Costs are summed in single precision; the damping falls and rises fast, for most corners need few steps.
_STOPPING = Stopping(iterations=24, damping=1e-4, rise=30.0, by_gain=False, restart=0.0, most=30.0, slack=1e-6)
_SETTLED_PX = 1e-3  # the step after such a step is of the order of 1e-5 px
_SETTLED = 0.05  # of a standard deviation
_LEVEL = 0.01  # of the sum of squares: what falls by more is on its way, even where the corner does not move
_RESTING_PX = 0.02  # where pictures are not like the model, steps go to and fro and lessen slowly
_FURTHEST = 0.35  # steps from the start; a fit that goes further has found something else
_COUNT = 11
# The unknowns as the elements of a state: corner, angles of the edges, logarithms of their blurs, and the light: level,
# contrast, tone, and the gradient over the window's reach. A step has the offsets of both edges where a state has the
# corner.
_PIXELS, _ANGLES, _BLURS, _LIGHT = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 11)
_OFFSETS, _CONTRAST, _TONE = _PIXELS, 7, 8


@dataclass(frozen=True, eq=False)
class RefinedCorners:
    """What was fitted at N corners.

    pixels: (N, 2). covariance: (N, 2, 2) px². blur: (N, 2) px, across the first and the second edge, the pixel's own
    square not counted. contrast: (N,) gray levels, half of bright minus dark, positive where the square before both
    steps is dark. noise: (N,) standard deviation of the residuals, gray levels. settled: (N,) whether the fit came to
    rest near its start; elsewhere pixels are the start and covariance, blur, contrast and noise are NaN.
    """

    pixels: Array
    covariance: Array
    blur: Array
    contrast: Array
    noise: Array
    settled: Array

    def __post_init__(self) -> None:
        count = len(self.pixels)
        shapes = {"pixels": (2,), "covariance": (2, 2), "blur": (2,), "contrast": (), "noise": ()}
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), (count, *shape), name))
        object.__setattr__(self, "settled", readonly(self.settled, (count,), "settled", np.bool_))


def refine(
    gray: Array,
    pixels: Array,
    cells: Cells,
    blur_px: float,
    sites: Array | None = None,
    longest_px: float = LONGEST_PX,
) -> RefinedCorners:
    """Return corners fitted from starts pixels (N, 2), good to half a pixel or so.

    gray: (H, W), uint8 or any other kind of number. blur_px: about the blur of the edges, the pixel's own square
    included, which says how far from them to look. sites: (H, W) mask of the pixels that count, such as those of one
    colour of a mosaic; None for all. longest_px: how far along an edge to look at most; the farther, the more it
    matters how the edge bends.
    """
    window = sample_cells(gray, pixels, cells, blur_px, sites, longest_px)
    beside = cells.beside if cells.crowded(blur_px) else None
    corners = _Corners(window, cells.bends, pixels, beside)
    states, every = corners.start(pixels, cells, blur_px), np.arange(len(pixels))
    fit = minimise_each(corners, states, every, _STOPPING, enough=corners.enough)
    return _result(fit, corners, pixels, cells, ROUNDING if gray.dtype == np.uint8 else 0.0)


@dataclass(frozen=True, eq=False)
class _Corners:
    """The fits of N corners, for the solver: states (N, 11), steps (N, 11).

    bends: (N, 2) of their edges. beside: the edges beside them if the blur brings them in, lines from `places` (N, 2).
    """

    window: CellWindow
    bends: Array
    places: Array
    beside: Beside | None

    def take(self, rows: Array) -> "_Corners":
        """Return some of the corners."""
        beside = None if self.beside is None else self.beside.take(rows)
        return _Corners(self.window.take(rows), self.bends[rows], self.places[rows], beside)

    def start(self, pixels: Array, cells: Cells, blur_px: float) -> Array:
        """Return edges along the steps, and the light by linear least squares."""
        states = np.zeros((len(pixels), _COUNT))
        states[:, _PIXELS] = pixels
        states[:, _ANGLES] = np.arctan2(cells.steps[:, 1], cells.steps[:, 0])
        states[:, _BLURS] = np.log(np.clip(blur_px, *_BLUR_PX))
        states[:, _CONTRAST] = 1.0
        linear = self.evaluate(states)[1][:, 6:8]
        normal = (linear @ linear.swapaxes(1, 2)).astype(np.float64) + 1e-6 * np.eye(2)
        weighted = (linear @ (self.window.values * self.window.used)[..., None]).astype(np.float64)
        states[:, 6:8] = np.linalg.solve(normal, weighted)[..., 0]
        return states

    def linearise(self, states: Array, which: Array) -> Models:
        """Return the models of half the sums of squares."""
        residuals, jacobian = self.take(which).evaluate(states)
        cost = 0.5 * np.einsum("nk,nk->n", residuals, residuals).astype(np.float64)
        normal = (jacobian @ jacobian.swapaxes(1, 2)).astype(np.float64)
        normal += 1e-6 * np.eye(_COUNT)  # cells with fewer pixels than unknowns
        return Models(cost, -(jacobian @ residuals[..., None])[..., 0].astype(np.float64), normal)

    def picture(self, states: Array, along: Array, away: Array) -> CheckerPicture:
        """Return the picture (N, K) of edges; along, away: (2, N, K) px along each edge and from it, to its left."""
        single = np.float32
        inverse = np.exp(-states[:, _BLURS]).astype(single).T[..., None]
        correlation = np.cos(states[:, [2]] - states[:, [3]]).astype(single)
        if self.beside is None:
            return alone(away[0] * inverse[0], away[1] * inverse[1], correlation)
        x, y = self.window.offsets(self.places)
        scaled = []
        for edge in (0, 1):
            bend = (self.bends[:, [edge]] / 2).astype(single) * along[edge] ** 2
            lines = self.beside.lines[:, edge].astype(single)[..., None]
            right, left = (lines[:, k, 0] * x + lines[:, k, 1] * y + lines[:, k, 2] - bend for k in (0, 1))
            scaled.append(np.stack([right, away[edge], left]) * inverse[edge])
        return crowded(scaled[0], scaled[1], correlation, self.beside.border, np.sign(states[:, [_CONTRAST]]))

    def evaluate(self, states: Array) -> tuple[Array, Array]:
        """Return values minus model (N, K) and the model's derivatives (N, 11, K).

        In single precision: sums of a thousand small numbers.
        """
        single = np.float32
        x, y = self.window.offsets(states[:, _PIXELS])
        angles = states[:, _ANGLES]
        cos, sin = (part.astype(single).T[..., None] for part in (np.cos(angles), np.sin(angles)))
        along = cos * x + sin * y
        away = cos * y - sin * x - (self.bends / 2).astype(single).T[..., None] * along**2
        seen, by_distances, by_blurs = self.picture(states, along, away)
        level, contrast, tone, slope_x, slope_y = states[:, _LIGHT].astype(single).T[..., None]
        over_x, over_y = x * self.window.scale, y * self.window.scale
        gain = (1 + slope_x * over_x + slope_y * over_y) * self.window.used
        curved, by_picture, by_tone = apply_tone(seen, tone)
        shape = level + contrast * curved
        slope = -gain * contrast * by_picture
        inverse = np.exp(-states[:, _BLURS]).astype(single).T[..., None]
        jacobian = np.empty((len(x), _COUNT, x.shape[1]), single)
        for edge, by_distance in enumerate(by_distances):
            jacobian[:, edge] = slope * by_distance * inverse[edge]
            jacobian[:, 2 + edge] = jacobian[:, edge] * along[edge]
        for edge, by_blur in enumerate(by_blurs):
            jacobian[:, 4 + edge] = slope * by_blur
        jacobian[:, 6], jacobian[:, 7], jacobian[:, 8] = gain, gain * curved, gain * contrast * by_tone
        lit = self.window.used * shape
        jacobian[:, 9], jacobian[:, 10] = over_x * lit, over_y * lit
        return self.window.values * self.window.used - gain * shape, jacobian

    def retract(self, states: Array, steps: Array) -> Array:
        """Return the states after steps, blurs and tone within what they may be."""
        moved = states + steps
        moved[:, _PIXELS] = states[:, _PIXELS] + np.linalg.solve(_normals(states), steps[:, _OFFSETS, None])[..., 0]
        moved[:, _BLURS] = np.clip(moved[:, _BLURS], *np.log(_BLUR_PX))
        moved[:, _TONE] = np.clip(moved[:, _TONE], -STRONGEST, STRONGEST)
        return moved

    def enough(self, tried: Trial) -> Array:
        """Return after which steps (A,) a corner stays where it is, and its picture has come to its level: a step so
        small that does not lower the cost is no reason to look for a smaller one.
        """
        level = np.abs(tried.fall) <= _LEVEL * tried.before.cost
        small = self.small(tried.before, tried.which, _SETTLED_PX, _SETTLED)
        return np.asarray(level & (_length(tried.steps) < small))

    def small(self, models: Models, which: Array, px: float, deviations: float) -> Array:
        """Return lengths (A,) of `px`, or so many standard deviations of a corner where that is more."""
        count = self.window.used[which].sum(axis=1) + 1e-9
        least = models.normal[:, [0, 1], [0, 1]].min(axis=1)
        return np.asarray(np.maximum(px, deviations * np.sqrt(2 * models.cost / count / least)))


def _length(steps: Array) -> Array:
    """Return how far (A,) px steps (A, 11) take corners."""
    return np.asarray(np.abs(steps[:, _OFFSETS]).max(axis=1))


def _normals(states: Array) -> Array:
    """Return the left normals (N, 2, 2) of both edges, one a row."""
    angles = states[:, _ANGLES]
    return np.stack([-np.sin(angles), np.cos(angles)], axis=-1)


def _result(fit: Minima, corners: _Corners, start: Array, cells: Cells, rounding: float) -> RefinedCorners:
    states = fit.states
    dof = corners.window.used.sum(axis=1) - _COUNT
    variance = np.maximum(2 * fit.cost / np.maximum(dof, 1), rounding)
    step = np.linalg.norm(cells.steps, axis=1).min(axis=1)
    near = np.linalg.norm(states[:, _PIXELS] - start, axis=1) < _FURTHEST * step
    resting = _length(fit.steps) < corners.small(fit.models, fit.which, _RESTING_PX, 1.0)
    settled = resting & near & (dof > _COUNT)
    inverse = np.linalg.inv(fit.models.normal)[:, _OFFSETS, _OFFSETS]
    to_pixels = np.linalg.inv(_normals(states))
    covariance = to_pixels @ inverse @ to_pixels.swapaxes(1, 2) * variance[:, None, None]
    covariance = (covariance + covariance.swapaxes(1, 2)) / 2  # symmetric to the last digit, as files have it
    settled &= (np.linalg.det(covariance) > 0) & (np.trace(covariance, axis1=1, axis2=2) > 0)  # else ill-conditioned
    kept = np.where(settled, 1.0, np.nan)
    return RefinedCorners(
        np.where(settled[:, None], states[:, _PIXELS], start),
        covariance * kept[:, None, None],
        np.sqrt(np.maximum(np.exp(2 * states[:, _BLURS]) - PIXEL_VARIANCE, 0.0)) * kept[:, None],
        states[:, _CONTRAST] * kept,
        np.sqrt(variance) * kept,
        settled,
    )
