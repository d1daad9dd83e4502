"""The variances of effects within views by restricted maximum likelihood (REML), and each view's share in them.

With coefficients c ~ N(0, D) of a view, D diagonal and q_va τ_a for the coefficients of effect a, everything is solved
for in standard deviations: c = √D z. The derivative of the restricted likelihood by log τ_a is then ½ Σ (z² - m), where
m is the part of a coefficient's prior variance that the data have used up (1 minus its variance given the data).
Source: Harville 1977, section 5 (the scores from predicted effects); Patterson & Thompson 1971.
"""

from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import EFFECTS, EffectColumns
from camcal.solve.steps import Factors, NormalEquations, Step, factorise

_POSE = 6
_SHARE_DOF = 4.0  # degrees of freedom of the prior by which a view's variance is that of all views
_LOG_STD = 3.0  # of the prior of log τ about a third of the noise: wide, it only keeps what is not there from zero
_DAMPING, _LONGEST, _ROUNDS, _SETTLED = 0.6, 1.0, 3, 1e-2


@dataclass(frozen=True, eq=False)
class EffectScales:
    """variances: τ (A,) of EFFECTS, px² (of flex the square of the board's unit). shares: q (V, A) of each view.
    typical: (A,) the variances about which the prior of τ lies.
    """

    variances: Array
    shares: Array
    typical: Array

    @classmethod
    def start(cls, views: int, sigma: float, side: float) -> "EffectScales":
        """Return the scales to begin with, for noise of `sigma` px and a board of that longer side."""
        typical = np.array([(1e-4 * side) ** 2 if effect.of_board else (0.3 * sigma) ** 2 for effect in EFFECTS])
        return cls(typical, np.ones((views, len(EFFECTS))), typical)

    def std(self, effect: Array) -> Array:
        """Return the standard deviations (V, m) of coefficients; effect: (m,) which effect each belongs to."""
        return np.asarray(np.sqrt(self.shares * self.variances)[:, effect])


def scaled(equations: NormalEquations, std: Array) -> NormalEquations:
    """Return the equations of coefficients in standard deviations (V, m), with their prior: standard normal."""
    by = np.concatenate([np.ones((len(std), _POSE)), std], axis=1)
    group = equations.group_group * by[:, :, None] * by[:, None, :]
    diagonal = np.einsum("vii->vi", group)
    diagonal[:, _POSE:] += 1.0
    return replace(
        equations,
        gradient=Step(equations.gradient.shared, equations.gradient.groups * by),
        group_group=group,
        group_shared=equations.group_shared * by[:, :, None],
    )


@dataclass(frozen=True, eq=False)
class Posterior:
    """What a solution leaves open. shared: (D, D) covariance of the parameters that all views share, but for offsets of
    single points. effects: (V, m, m) of the coefficients in standard deviations. spent: (V,) degrees of freedom that
    the corners of a view have spent on pose, effects and shared parameters.
    """

    shared: Array
    effects: Array
    spent: Array


def posterior(factors: Factors) -> Posterior:
    """Return what the factors of scaled equations leave open."""
    dense = factors.equations.group_products.shape[-1]
    shared = factors.shared_covariance()[:dense, :dense]
    inverse = factors.inverse_group_root()
    own = np.einsum("vki,vkj->vij", inverse[:, :, _POSE:], inverse[:, :, _POSE:])
    reduced = factors.reduced[:, :, :dense]
    coupling = inverse[:, :, _POSE:].transpose(0, 2, 1) @ reduced
    effects = own + coupling @ shared @ coupling.transpose(0, 2, 1)
    lens = np.einsum("vij,ji->v", factors.group_information(), shared)
    used = own.shape[-1] - np.einsum("vii->v", effects)
    return Posterior(shared, effects, _POSE + used + lens)


def fit_effects(equations: NormalEquations, columns: EffectColumns, scales: EffectScales) -> EffectScales:
    """Return the scales under which the residuals of one linearisation are likeliest.

    equations: with columns per unit of the coefficients, without their prior.
    """
    chosen = np.arange(equations.group_products.shape[-1])
    dense = equations.restricted(chosen)
    for _ in range(_ROUNDS):
        factors = factorise(scaled(dense, scales.std(columns.effect)))
        following = _updated(scales, columns.effect, factors.solve().groups[:, _POSE:], posterior(factors).effects)
        moved = np.abs(np.log(following.variances / scales.variances)).max()
        scales = following
        if moved < _SETTLED:
            break
    return scales


def _updated(scales: EffectScales, effect: Array, values: Array, open_part: Array) -> EffectScales:
    """Return scales after one scoring step; values: (V, m) coefficients in standard deviations."""
    member = [effect == index for index in range(len(scales.variances))]
    used = np.eye(len(effect)) - open_part
    squares = np.stack([np.sum(values[:, own] ** 2, axis=1) for own in member], axis=1)
    spent = np.stack([np.einsum("vii->v", used[:, own][:, :, own]) for own in member], axis=1)
    information = np.array([[np.sum(used[:, a][:, :, b] ** 2) for b in member] for a in member])
    slope = 0.5 * (squares - spent).sum(axis=0) - np.log(scales.variances / scales.typical) / _LOG_STD**2
    change = np.linalg.solve(0.5 * information + np.eye(len(member)) / _LOG_STD**2, slope)
    variances = scales.variances * np.exp(np.clip(_DAMPING * change, -_LONGEST, _LONGEST))
    shares = (_SHARE_DOF + scales.shares * squares) / (_SHARE_DOF + spent)
    return replace(scales, variances=variances, shares=shares)
