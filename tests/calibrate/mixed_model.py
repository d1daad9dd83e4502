"""Linear views of a pose, effects and shared parameters each, and their likelihood by dense matrices."""

from dataclasses import dataclass, replace

import numpy as np

from camcal.calibrate.effects import EffectColumns, EffectScales
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Block, Jacobian

VIEWS, ROWS = 5, 14  # rows of two coordinates each
EFFECT = np.repeat([0, 1, 2], [3, 2, 2])
COLUMNS = len(EFFECT)
LOG_STD, SHARE_DOF = 3.0, 4.0  # of the priors


@dataclass(frozen=True)
class Mixed:
    """Linear views: a pose of 6, effects, and `shared` parameters that follow a prior of their own."""

    pose: np.ndarray  # (V, 2 R, 6)
    effects: np.ndarray  # (V, 2 R, m)
    lens: np.ndarray  # (V, 2 R, D)
    weights: np.ndarray  # (V, R)
    observed: np.ndarray  # (V, 2 R)
    prior: np.ndarray  # (D,) standard deviations
    value: np.ndarray  # (D,) what is observed of the shared parameters by their prior

    def blocks(self, by=None, *, prior=None):
        """The residual blocks at zero; by: (V, m) factors of the effects' columns; prior: of their coefficients."""
        effects = self.effects if by is None else self.effects * by[:, None, :]
        group = np.concatenate([self.pose, effects], axis=2)
        result = [
            Block(
                -self.observed.reshape(-1, 2),
                (Jacobian(self.lens.reshape(VIEWS * ROWS, 2, -1), np.arange(self.lens.shape[2])),),
                group.reshape(VIEWS * ROWS, 2, -1),
                rows_per_group=ROWS,
                weights=self.weights.ravel(),
            )
        ]
        if self.lens.shape[2]:
            columns = np.arange(self.lens.shape[2])[:, None]
            result.append(
                Block(-(self.value / self.prior)[:, None], (Jacobian((1 / self.prior)[:, None, None], columns),))
            )
        if prior is not None:
            rows = np.concatenate([np.zeros((COLUMNS, 6)), prior * np.eye(COLUMNS)], axis=1)
            repeated = np.tile(rows, (VIEWS, 1))[:, None, :]
            result.append(Block(np.zeros((len(repeated), 1)), (), repeated, rows_per_group=COLUMNS))
        return result

    def equations(self, **how):
        return assemble(self.blocks(**how), self.lens.shape[2], VIEWS, 6 + COLUMNS)

    def fixed(self):
        """The columns (N, 6 V + D) of what has no prior variance to find: poses and lens, then rows of the prior."""
        count = self.lens.shape[2]
        top = np.concatenate([block_diagonal(self.pose), self.lens.reshape(VIEWS * 2 * ROWS, count)], axis=1)
        bottom = np.concatenate([np.zeros((count, 6 * VIEWS)), np.diag(1 / self.prior)], axis=1)
        return np.concatenate([top, bottom])

    def random(self):
        """The columns (N, V m) of the effects."""
        return np.concatenate([block_diagonal(self.effects), np.zeros((self.lens.shape[2], VIEWS * COLUMNS))])

    def noise(self):
        """The variances (N,) of all rows."""
        return np.concatenate([1 / np.repeat(self.weights.ravel(), 2), np.ones(self.lens.shape[2])])

    def everything(self):
        return np.concatenate([self.observed.ravel(), self.value / self.prior])

    def projector(self, std):
        """P = V⁻¹ - V⁻¹ X (Xᵀ V⁻¹ X)⁻¹ Xᵀ V⁻¹ and the logarithms of the determinants of V and of Xᵀ V⁻¹ X."""
        random = self.random() * std.ravel()
        inverse = np.linalg.inv(np.diag(self.noise()) + random @ random.T)
        fixed = self.fixed()
        information = fixed.T @ inverse @ fixed
        taken = inverse @ fixed
        logs = -np.linalg.slogdet(inverse)[1], np.linalg.slogdet(information)[1]
        return inverse - taken @ np.linalg.solve(information, taken.T), logs

    def restricted(self, scales):
        """The restricted log likelihood, Patterson & Thompson 1971, up to a constant."""
        projector, logs = self.projector(scales.std(EFFECT))
        y = self.everything()
        return -0.5 * (sum(logs) + y @ projector @ y)

    def hat(self, std):
        """The matrix (N, N) that takes observed to fitted values, effects included."""
        columns = np.concatenate([self.random() * std.ravel(), self.fixed()], axis=1)
        weighted = columns / self.noise()[:, None]
        ridge = np.zeros(columns.shape[1])
        ridge[: VIEWS * COLUMNS] = 1.0
        return columns @ np.linalg.solve(columns.T @ weighted + np.diag(ridge), weighted.T)


def block_diagonal(parts):
    views, rows, columns = parts.shape
    result = np.zeros((views, rows, views, columns))
    result[np.arange(views), :, np.arange(views)] = parts
    return result.reshape(views * rows, views * columns)


def mixed(seed=1, shared=4, sizes=(0.8, 0.5, 1.2)):
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=(VIEWS, 2 * ROWS, 6))
    effects = rng.normal(size=(VIEWS, 2 * ROWS, COLUMNS)) * [1, 0.5, 2, 1, 1, 0.3, 1.5]
    lens = rng.normal(size=(VIEWS, 2 * ROWS, shared)) + rng.normal(size=(1, 2 * ROWS, shared))
    weights = rng.uniform(0.3, 3, (VIEWS, ROWS))
    # an effect that a lens parameter resembles
    lens[:, :, : min(shared, 2)] += 2 * effects[:, :, : min(shared, 2)]
    drawn = np.array(sizes)[EFFECT] * rng.normal(size=(VIEWS, COLUMNS))
    noise = rng.normal(size=(VIEWS, 2 * ROWS)) / np.sqrt(np.repeat(weights, 2, axis=1))
    observed = np.einsum("vrm,vm->vr", effects, drawn) + noise
    observed += np.einsum("vrk,vk->vr", pose, rng.normal(size=(VIEWS, 6))) + lens @ rng.normal(size=shared)
    return Mixed(pose, effects, lens, weights, observed, rng.uniform(0.5, 2, shared), rng.normal(size=shared))


def scales(seed=2, spread=0.7):
    rng = np.random.default_rng(seed)
    return EffectScales(
        np.exp(spread * rng.normal(size=3)), np.exp(0.5 * rng.normal(size=(VIEWS, 3))), np.array([0.1, 0.4, 2.0])
    )


def columns_of(model):
    """The same effects as the estimator lays them out."""
    values = model.effects.reshape(VIEWS, ROWS, 2, COLUMNS).transpose(2, 3, 0, 1)
    return EffectColumns(values, EFFECT)


def moved(start, change):
    """The scales after a change (18,) of the logarithms of variances and shares."""
    change = change.reshape(1 + VIEWS, 3)
    return replace(start, variances=start.variances * np.exp(change[0]), shares=start.shares * np.exp(change[1:]))


def unlikeliness(model, trial):
    """Minus the logarithm of restricted likelihood and priors."""
    offset = np.log(trial.variances / trial.typical)
    shares = -0.5 * SHARE_DOF * np.sum(np.log(trial.shares) + 1 / trial.shares)
    return -(model.restricted(trial) - 0.5 * np.sum(offset**2) / LOG_STD**2 + shares)


def slope_and_information(model, start):
    """The slope (18,) of restricted likelihood and priors by the logarithms of variances and shares, by differences,
    and its information (18, 18): tr(P V_a P V_b) of the parts within views alone, and what the priors say.
    """
    length, count = 1e-4, 3 + 3 * VIEWS  # differences of a likelihood of about 100: slopes to 1e-8
    slope = np.array(
        [
            (unlikeliness(model, moved(start, -length * axis)) - unlikeliness(model, moved(start, length * axis)))
            for axis in np.eye(count)
        ]
    ) / (2 * length)
    std = start.std(EFFECT)
    used = (model.random() * std.ravel()).T @ model.projector(std)[0] @ (model.random() * std.ravel())
    information = np.diag(np.concatenate([np.full(3, LOG_STD**-2), 0.5 * SHARE_DOF / start.shares.ravel()]))
    for view in range(VIEWS):
        own = used[view * COLUMNS : (view + 1) * COLUMNS, view * COLUMNS : (view + 1) * COLUMNS]
        part = [[0.5 * np.sum(own[np.ix_(a == EFFECT, b == EFFECT)] ** 2) for b in range(3)] for a in range(3)]
        all_views, this = np.arange(3), 3 + 3 * view + np.arange(3)
        for rows in (all_views, this):
            for columns in (all_views, this):
                information[np.ix_(rows, columns)] += part
    return slope, information
