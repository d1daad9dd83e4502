"""Errors within single views as zero-mean random effects: their design columns beside those of the pose.

smooth: a field over the board, whatever its cause (blur, compression, air, a lens that focuses). rolling: the rows of
the image were exposed one after the other while the camera moved. flex: the board bent out of its own shape.
A coefficient of variance τ moves the corners of a view by √τ RMS: pixels, for flex the board's unit.

Their variances are those of restricted maximum likelihood (REML), with each view's share in them. With coefficients c ~
N(0, D) of a view, D diagonal and q_va τ_a for the coefficients of effect a, everything is solved for in standard
deviations: c = √D z. The derivative of the restricted likelihood by log τ_a is then ½ Σ (z² - m), where m is the part
of a coefficient's prior variance that the data have used up (1 minus its variance given the data).
Source: Harville 1977, section 5 (the scores from predicted effects); Patterson & Thompson 1971.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE, BoardProblem, Derivatives, State
from camcal.cameras.observations import by_pose
from camcal.dataclass import dataclass, field, replace
from camcal.solve.steps import Factors, NormalEquations, Step, factorise, lowest_along
from camcal.targets.board import CLASSES, Board, basis, normalised

SMOOTH_DEGREE = 3
# how fast the spectrum of a field with the correlation exp(-d / 4 squares) falls, by degree: seen on boards of 6 x 4 to
# 14 x 10 corners
_SPECTRUM = (0.0, 1.0, 0.3, 0.12)
FLEX_TERMS = tuple(term for name in ("twist", "bow", "cubic") for term in CLASSES[name].terms)

SHARE_DOF = 4.0  # degrees of freedom of the prior by which a view's variance is that of all views
_LOG_STD = 3.0  # of the prior of log τ about a third of the noise: wide, it only keeps what is not there from zero
# Scoring steps: the longest, of logarithms; how many in one linearisation; a gain of the log likelihood that is not
# worth another. Where effects are not seen the likelihood is more curved than expected and full steps overshoot: a step
# is as long as the likelihood along it is highest. How near to that is near enough, trials, and how much shorter one
# may be than the one before.
_LONGEST, _ROUNDS, _MANY_ROUNDS, _SETTLED = 2.0, 4, 30, 1e-3
_NEAR, _TRIALS, _SHORTEST = 0.75, 5, 0.2
_NOTHING = 1e-12  # times a variance: as if there were no effect


@dataclass(frozen=True)
class Effect:
    """One kind of effect: its name, the columns that a view has of it, and whether its coefficients are the board's (in
    its unit) or pixels.
    """

    name: str
    columns: int
    of_board: bool = False


SMOOTH = Effect("smooth", 2 * sum(degree + 1 for degree in range(1, SMOOTH_DEGREE + 1)))
ROLLING = Effect("rolling", 6)
FLEX = Effect("flex", len(FLEX_TERMS), of_board=True)
EFFECTS = (SMOOTH, ROLLING, FLEX)


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """The columns (2, m, V, P) of effects, pixels per unit of a coefficient, and which effect each belongs to (m,)."""

    values: Array
    effect: Array

    def of(self, effects: Sequence[int]) -> "EffectColumns":
        """Return the columns of some effects alone, by their places in EFFECTS."""
        chosen = np.isin(self.effect, list(effects))
        if chosen.all():
            return self
        return EffectColumns(np.ascontiguousarray(self.values[:, chosen]), self.effect[chosen])


def columns_at(problem: BoardProblem, state: State, derivatives: Derivatives, names: Sequence[str]) -> EffectColumns:
    """Return the columns of the effects of some names at a state; at states nearby they differ by scale alone."""
    present = problem.observations.present
    if not names:
        return EffectColumns(np.zeros((2, 0, *present.shape)), np.zeros(0, np.intp))
    columns = effect_columns(
        problem.board,
        problem.observations.ids,
        # as projected: columns with the noise of measured corners in them could explain this noise
        problem.observations.pixels + derivatives.residuals.reshape(2, *present.shape),
        motion_columns(problem.board, state.rotations, derivatives, present),
        np.moveaxis(derivatives.by_board(state.rotations)[..., 2], 2, 0),
        present,
    )
    return columns.of([index for index, effect in enumerate(EFFECTS) if effect.name in names])


def effect_columns(
    board: Board, ids: Array, pixels: Array, motion: Array, by_height: Array, present: Array
) -> EffectColumns:
    """Return the columns of all EFFECTS for V views of P corners.

    ids: (V, P). pixels: (2, V, P) of the projected corners. motion: (2, 6, V, P), see `motion_columns`. by_height:
    (2, V, P) by a corner's height over the board. present: (V, P) bool.
    """
    values = np.zeros((2, sum(effect.columns for effect in EFFECTS), *ids.shape))
    modes = SMOOTH.columns // 2
    values[0, :modes] = values[1, modes : 2 * modes] = _smooth(board)[:, ids]
    rows = pixels[1]
    time = (rows - np.mean(rows[present])) / max(float(np.std(rows[present])), 1.0)  # of unit variance over all corners
    # a board held by hand shifts, and turns about its middle, by as much: so much of it as shifts the view by 1 px RMS
    shifted = np.sum(motion[:, :2] ** 2, axis=(0, 1, 3)) / (2 * np.maximum(present.sum(axis=1), 1))
    rolling = slice(SMOOTH.columns, SMOOTH.columns + ROLLING.columns)
    values[:, rolling] = time * motion / np.sqrt(np.maximum(shifted, 1e-30))[:, None]
    values[:, rolling.stop :] = by_height[:, None] * np.moveaxis(basis(board, FLEX_TERMS)[:, 2][ids], 2, 0)
    values *= present
    return EffectColumns(values, np.repeat(np.arange(len(EFFECTS)), [effect.columns for effect in EFFECTS]))


def motion_columns(board: Board, rotations: Array, derivatives: Derivatives, present: Array) -> Array:
    """Return the columns (2, 6, V, P), px per unit of the board, of a motion of the board in each view: a shift, and a
    turn about its middle that moves its edge by as much.

    rotations: (V, 3, 3) camera_T_board. present: (V, P) bool, the corners that move.
    """
    points = board.points()
    shape = len(rotations), -1
    arms = derivatives.rotated.reshape(3, *shape) - (rotations @ points.mean(axis=0)).T[:, :, None]
    columns = by_pose(derivatives.by_point.reshape(2, 3, *shape), arms)
    columns[:, 3:] /= radius(points)
    return np.asarray(columns * present)


def radius(points: Array) -> float:
    """Return the RMS distance of points (C, 3) from their centre."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def _smooth(board: Board) -> Array:
    """Return the modes (m / 2, C) of a smooth field in one coordinate, whose sum has a mean square of 1 at unit
    coefficients.
    """
    x, y = normalised(board).T
    modes, shares = [], []
    for degree in range(1, SMOOTH_DEGREE + 1):
        for order in range(degree + 1):
            modes.append(_legendre(degree - order, x) * _legendre(order, y))
            shares.append(_SPECTRUM[degree])
    values = np.array(modes) * np.sqrt(np.array(shares) / np.sum(shares))[:, None]
    return np.asarray(values)


def _legendre(degree: int, values: Array) -> Array:
    """Return the Legendre polynomial of unit mean square over [-1, 1]."""
    return np.asarray(np.sqrt(2 * degree + 1) * np.polynomial.legendre.legval(values, np.eye(degree + 1)[degree]))


@dataclass(frozen=True, eq=False)
class EffectScales:
    """variances: τ (A,) of EFFECTS, px² (of flex the square of the board's unit). shares: q (V, B) of each view.
    typical: (A,) the variances about which the prior of τ lies. share_of: (A,) the column of `shares` of each effect.
    share_dof: (B,) degrees of freedom of the prior by which the shares are about 1.
    """

    variances: Array
    shares: Array
    typical: Array
    share_of: Array = field(default_factory=lambda: np.arange(len(EFFECTS)))
    share_dof: Array = field(default_factory=lambda: np.full(len(EFFECTS), SHARE_DOF))

    @classmethod
    def start(cls, views: int, sigma: float, side: float) -> "EffectScales":
        """Return the scales to begin with, for noise of `sigma` px and a board of that longer side."""
        typical = np.array([(1e-4 * side) ** 2 if effect.of_board else (0.3 * sigma) ** 2 for effect in EFFECTS])
        return cls(typical, np.ones((views, len(EFFECTS))), typical)

    def moved(self, change: Array) -> "EffectScales":
        """Return the scales with changed logarithms (A + V B,) of variances and of shares."""
        variances, shares = np.split(np.exp(change), [len(self.variances)])
        return replace(
            self, variances=self.variances * variances, shares=self.shares * shares.reshape(self.shares.shape)
        )

    def towards(self, other: "EffectScales", share: float) -> "EffectScales":
        """Return the scales a share of the way to others, in logarithms."""
        variances = self.variances * (other.variances / self.variances) ** share
        return replace(self, variances=variances, shares=self.shares * (other.shares / self.shares) ** share)

    def log_prior(self) -> float:
        """Return the logarithm of their prior density, up to a constant."""
        offset = np.log(self.variances / self.typical)
        shares = np.log(self.shares) + 1 / self.shares
        return float(-0.5 * np.sum(offset**2) / _LOG_STD**2 - 0.5 * np.sum(self.share_dof * shares))

    def prior_slopes(self) -> tuple[Array, Array]:
        """Return the derivatives of `log_prior` by the logarithms of variances (A,) and of shares (V, B)."""
        return -np.log(self.variances / self.typical) / _LOG_STD**2, -0.5 * self.share_dof * (1 - 1 / self.shares)

    def prior_curvatures(self) -> tuple[Array, Array]:
        """Return minus the second derivatives, as `prior_slopes`."""
        return np.full(len(self.variances), _LOG_STD**-2), 0.5 * self.share_dof / self.shares

    def std(self, effect: Array) -> Array:
        """Return the standard deviations (V, m) of coefficients; effect: (m,) which effect each belongs to."""
        return np.asarray(np.sqrt(self.shares[:, self.share_of] * self.variances)[:, effect])


def scaled(equations: NormalEquations, std: Array) -> NormalEquations:
    """Return the equations of coefficients in standard deviations (V, m), with their prior: standard normal.

    The coefficients are the last m parameters of a group.
    """
    pose = equations.group_group.shape[-1] - std.shape[1]
    by = np.concatenate([np.ones((len(std), pose)), std], axis=1)
    group = equations.group_group * by[:, :, None] * by[:, None, :]
    diagonal = np.einsum("vii->vi", group)
    diagonal[:, pose:] += 1.0
    return replace(
        equations,
        gradient=Step(equations.gradient.shared, equations.gradient.groups * by),
        group_group=group,
        group_shared=equations.group_shared * by[:, :, None],
    )


@dataclass(frozen=True, eq=False)
class Posterior:
    """What a solution leaves open. shared: (D, D) covariance of the parameters that all views share, but for offsets of
    single points. spent: (V,) degrees of freedom that the corners of a view have spent on pose, effects and shared
    parameters; where offsets are among these, what `spent_on_offsets` says is to be added.
    """

    shared: Array
    spent: Array


def posterior(factors: Factors) -> Posterior:
    """Return what the factors of scaled equations leave open."""
    products, reduced, covariance = factors.equations.group_products, factors.reduced, factors.shared_covariance()
    shared = covariance[: products.shape[-1], : products.shape[-1]]
    rows = np.concatenate(list(reduced))  # one product is faster than one for each group
    followed = (rows @ covariance).reshape(reduced.shape)
    inverse = factors.group_inverse[:, POSE:, POSE:].transpose(0, 2, 1)  # of a lower triangle: zero above
    # what is left open of the effects: the traces of their covariances
    coupling, further = inverse @ reduced[:, POSE:], inverse @ followed[:, POSE:]
    effects = np.sum(inverse**2, axis=(1, 2)) + np.sum(coupling * further, axis=(1, 2))
    lens = np.sum(products * shared, axis=(1, 2)) - np.sum(reduced * followed, axis=(1, 2))
    return Posterior(shared, POSE + inverse.shape[-1] - effects + lens)


def fit_effects(equations: NormalEquations, effect: Array, scales: EffectScales) -> EffectScales:
    """Return the scales under which the residuals of one linearisation are likeliest, or the way there.

    equations: with columns per unit of the coefficients, without their prior. effect: (m,) which effect each belongs
    to.
    """
    search = _Search.of(equations, effect)
    return search.best(scales, _ROUNDS).scales


def likelihood_gain(equations: NormalEquations, effect: Array, start: EffectScales) -> float:
    """Return the gain of the restricted log likelihood by effects of the likeliest scales, over that of none."""
    search = _Search.of(equations, effect)
    best = search.best(start, _MANY_ROUNDS)
    nothing = search.at(replace(best.scales, variances=_NOTHING * best.scales.variances))
    return nothing.unlikeliness + nothing.scales.log_prior() - best.unlikeliness - best.scales.log_prior()


@dataclass(frozen=True, eq=False)
class _Point:
    """Scales, the factors of their equations, and minus the logarithm of their restricted likelihood and priors."""

    scales: EffectScales
    factors: Factors
    unlikeliness: float


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for scales in one linearisation. effect: (m,) which effect each coefficient belongs to."""

    equations: NormalEquations
    effect: Array

    @classmethod
    def of(cls, equations: NormalEquations, effect: Array) -> "_Search":
        """Return the search; equations: with columns per unit of the coefficients, without their prior."""
        dense = equations.restricted(np.arange(equations.group_products.shape[-1]))
        return cls(dense.without_first(POSE), effect)

    def best(self, scales: EffectScales, rounds: int) -> _Point:
        """Return the likeliest scales, or how far as many scoring steps lead."""
        here = self.at(scales)
        for _ in range(rounds):
            change, promised = self.step(here)
            if promised < _SETTLED:
                break
            share = 1.0
            for _ in range(_TRIALS):
                there = self.at(here.scales.moved(share * change))
                best = lowest_along(promised, share, there.unlikeliness - here.unlikeliness)
                if best > _NEAR * share:
                    break
                share = max(best, _SHORTEST * share)
            if there.unlikeliness > here.unlikeliness:
                break
            here = there
        return here

    def at(self, scales: EffectScales) -> _Point:
        factors = factorise(scaled(self.equations, scales.std(self.effect)))
        likelihood = -self.equations.cost + factors.decrease() - 0.5 * factors.log_determinant()
        return _Point(scales, factors, -likelihood - scales.log_prior())

    def step(self, point: _Point) -> tuple[Array, float]:
        """Return the scoring step (A + V B,) of the logarithms of variances and shares, and its predicted gain.

        What views say of each other's scales is left out of the information: it is little, and would be a matrix of all
        views by all views.
        """
        values, scales = point.factors.solve().groups, point.scales
        used = np.eye(len(self.effect)) - point.factors.group_covariances()
        member = (self.effect == np.arange(len(scales.variances))[:, None]).astype(float)
        score = 0.5 * (values**2 - np.einsum("vii->vi", used)) @ member.T
        information = 0.5 * member @ used**2 @ member.T
        slope, own_slope = scales.prior_slopes()
        curvature, own_curvature = scales.prior_curvatures()
        # the shares of a view follow the variances: they are eliminated as poses are from the lens
        belongs = (scales.share_of[:, None] == np.arange(scales.shares.shape[1])).astype(float)
        cross, own_gradient = information @ belongs, score @ belongs + own_slope
        own = belongs.T @ cross + own_curvature[:, :, None] * np.eye(belongs.shape[1])
        right = np.concatenate([cross.transpose(0, 2, 1), own_gradient[:, :, None]], axis=2)
        gone = np.linalg.solve(own, right)
        reduced = (information - cross @ gone[:, :, :-1]).sum(axis=0) + np.diag(curvature)
        gradient = score.sum(axis=0) + slope
        change = np.linalg.solve(reduced, gradient - (cross @ gone[:, :, -1:]).sum(axis=0)[:, 0])
        shares = gone[:, :, -1] - gone[:, :, :-1] @ change
        step = np.clip(np.concatenate([change, shares.ravel()]), -_LONGEST, _LONGEST)
        return step, 0.5 * float(np.concatenate([gradient, own_gradient.ravel()]) @ step)
