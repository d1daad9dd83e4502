"""Checks of parameters that should be equal in all views: focal length, board, image sharpness.

A change is told from errors within views (rolling shutter, a board that bends) by its order, or by two groups of views,
and not by how large residuals are: such errors make them larger without any order.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import columns_at
from camcal.calibrate.estimator import Estimate
from camcal.calibrate.problem import POSE, Derivatives
from camcal.calibrate.single_views import EntrancePupil, ViewOffsets, entrance_pupil, followed
from camcal.dataclass import dataclass, field, replace
from camcal.records import Brief
from camcal.targets.board import RATIOS, basis

_VIEWS = 60  # where there are more, so many of them tell all that is asked here
_LEAST_VIEWS = 5
_FEWEST = 2  # views before a change, and after it
_SEVERAL = 0.25  # of the views, at most, are said to have another focal length each
_FURTHER = 3.0  # standard deviations by which a view differs that is named with the one that differs most
_COMMON = 5  # corners that two views have in common, to be compared
# Of the variance of a principal component of the views, what two groups explain if it lies about two points: of normal
# values it is 0.64, and 0.87 is rare. Standard deviations that a division into groups gains by being chosen.
_TWO_POINTS, _CHOSEN = 0.92, 1.0
_CHANCE = 1e-3  # that a view of a set looks blurred by noise alone


@dataclass(frozen=True)
class Change:
    """Something that is not the same in all views.

    share: of itself, by how much it is larger in `images`; for a drift at the last view than at the first; for what
    varies without order its standard deviation. clear: in standard deviations, how far it is from chance,
    all places considered where it may have been.
    """

    share: float = 0.0
    clear: float = 0.0
    images: tuple[str, ...] = ()


@dataclass(frozen=True)
class TwoBoards:
    """Residuals that are alike on the board in two groups of views, and opposed between them.

    px: RMS distance of the corners of one board from those of the other. clear: in standard deviations, how far it is
    from chance. images: the second group, those after a change, or the smaller one.
    """

    px: float = 0.0
    clear: float = 0.0
    images: tuple[str, ...] = ()


@dataclass(frozen=True)
class Blur:
    """A view whose corners scatter in one direction. px: standard deviation in it. ratio: of the variance in it to that
    across, or to that of the corners of a typical view if this is larger.
    """

    image: str
    px: float
    ratio: float


@dataclass(frozen=True)
class BetweenViews(Brief):
    """The clearest of each kind of change, which may well be chance: the verdict decides.

    images: of all views, in their order. step, drift, outlying, unordered: of the focal length, from
    one view on, steadily, in single views, from view to view. blurred: views that are not as they are by chance.
    pupil: how near and far boards differ, of a wide lens.
    """

    images: tuple[str, ...] = ()
    step: Change = field(default_factory=Change)
    drift: Change = field(default_factory=Change)
    outlying: Change = field(default_factory=Change)
    unordered: Change = field(default_factory=Change)
    proportions: Change = field(default_factory=Change)
    boards: TwoBoards = field(default_factory=TwoBoards)
    blurred: tuple[Blur, ...] = ()
    pupil: EntrancePupil | None = None


def between_views(estimates: Sequence[Estimate], images: Sequence[str]) -> BetweenViews:
    """Return what differs between views by the estimate that takes errors within views for noise, the first one, and
    the one that models most of them, the last one.

    images: the names of the views.
    """
    count = len(images)
    if count < _LEAST_VIEWS:
        return BetweenViews(tuple(images))
    chosen = np.unique(np.linspace(0, count - 1, min(count, _VIEWS)).astype(np.intp))
    names = tuple(images[index] for index in chosen)
    plain = full = _Linearised.of(estimates[0], chosen)
    if len(estimates) > 1:
        full = _Linearised.of(estimates[-1], chosen)
    boards = _two_boards(plain, names)
    try:
        focal, proportions = full.offsets()
    except np.linalg.LinAlgError:  # these views do not determine lens and poses, as those of a wrong board may not
        return BetweenViews(tuple(images))

    def later(compared: tuple[str, ...]) -> tuple[str, ...]:
        """Return all views from a place on; compared: those of them that were compared."""
        return tuple(images[chosen[len(names) - len(compared)] :])

    step, ratio = _step(focal, names), _proportions(proportions, names)
    if boards.images == names[-len(boards.images) :]:
        boards = replace(boards, images=later(boards.images))
    return BetweenViews(
        tuple(images),
        replace(step, images=later(step.images)),
        drift=replace(_drift(focal, names), images=tuple(images)),
        outlying=_outlying(focal, names),
        unordered=Change(*focal.unordered()),
        proportions=replace(ratio, images=later(ratio.images)),
        boards=boards,
        blurred=_blurred(full, names),
        pupil=entrance_pupil(estimates[0]),
    )


@dataclass(frozen=True, eq=False)
class _Linearised:
    """An estimate of some views, linearised where it ended: columns and their std of the effects that it models."""

    estimate: Estimate
    present: Array
    derivatives: Derivatives
    columns: Array
    std: Array
    field: Array

    @classmethod
    def of(cls, estimate: Estimate, chosen: Array) -> "_Linearised":
        problem = replace(
            estimate.problem,
            observations=estimate.problem.observations.take(chosen),
            noise=estimate.noise.views[chosen],
            offsets=False,
        )
        state = estimate.state.take(chosen)
        estimate = replace(estimate, problem=problem, state=state, coefficients=estimate.coefficients[chosen])
        derivatives = problem.derivatives(state)
        columns = columns_at(problem, state, derivatives, estimate.additional.effects)
        std = np.zeros((len(chosen), 0))
        if estimate.effect_scales is not None:
            std = estimate.effect_scales.std(columns.effect)[chosen]
        explained = (columns.values.transpose(0, 2, 3, 1) @ estimate.coefficients[:, :, None])[..., 0]
        return cls(estimate, problem.observations.present, derivatives, columns.values, std, explained)

    @property
    def residuals(self) -> Array:
        """Residuals (2, V, P) px that effects do not explain, 0 without an image."""
        return np.asarray(self.derivatives.residuals.reshape(2, *self.present.shape) + self.field)

    @property
    def weights(self) -> Array:
        """How far the corners (V, P) count, against those of their own view."""
        weights = self.estimate.problem.observations.weights * self.present
        return np.asarray(weights / np.maximum(weights.max(axis=1, keepdims=True), 1e-12))

    def offsets(self) -> tuple[ViewOffsets, ViewOffsets]:
        """Return the information of the views on changes of the focal length and of the board."""
        own = np.concatenate([self.by_focal_length(), self.by_proportions()], axis=1) * self.present
        columns = np.concatenate([self.columns, own], axis=1)
        equations = self.estimate.problem.equations(self.estimate.state, self.derivatives, columns)
        left = followed(equations, POSE, self.std)
        return ViewOffsets.of(left, (0,)), ViewOffsets.of(left, (1, 2))

    def by_focal_length(self) -> Array:
        """Return the derivatives (2, 1, V, P) by the logarithm of the focal length."""
        problem, state = self.estimate.problem, self.estimate.state
        names = problem.model.parameter_names
        centre = np.array([state.parameters[names.index(name)] for name in ("cx", "cy")])
        projected = self.derivatives.residuals.reshape(2, *self.present.shape) + problem.observations.pixels
        return np.asarray((projected - centre[:, None, None])[:, None])

    def by_proportions(self) -> Array:
        """Return the derivatives (2, 2, V, P) by the ratio of the board's sides and by its shear."""
        problem = self.estimate.problem
        moved = basis(problem.board, RATIOS)[problem.observations.ids]
        return np.asarray(np.einsum("vpij,vpjk->ikvp", self.derivatives.by_board(self.estimate.state.rotations), moved))


def _places(count: int) -> Array:
    """Return the places of the first view after a change."""
    return np.arange(_FEWEST, count - _FEWEST + 1)


def _step(focal: ViewOffsets, images: tuple[str, ...]) -> Change:
    places = _places(len(images))
    found = focal.likeliest((np.arange(len(images))[:, None] >= places).astype(float))
    return Change(float(found.size[0]), found.clear(_independent(len(images))), images[int(places[found.index]) :])


def _independent(count: int) -> float:
    """Return how many places of a change among so many views are about as many as independent ones."""
    return float(2 * np.log(count))


def _drift(focal: ViewOffsets, images: tuple[str, ...]) -> Change:
    found = focal.likeliest(np.linspace(0, 1, len(images))[:, None])
    return Change(float(found.size[0]), found.clear(1), images)


def _outlying(focal: ViewOffsets, images: tuple[str, ...]) -> Change:
    """Return the views that differ most from the others; the change and how clear it is are those of the first."""
    count = len(images)
    first = focal.likeliest(np.eye(count))
    chosen, found = [first.index], first
    while found.clear(count) > _FURTHER and len(chosen) < _SEVERAL * count:
        found = focal.likeliest(np.eye(count), np.eye(count)[:, chosen])
        chosen += [found.index] if found.clear(count) > _FURTHER else []
    return Change(float(first.size[0]), first.clear(count), tuple(images[index] for index in sorted(chosen)))


def _proportions(board: ViewOffsets, images: tuple[str, ...]) -> Change:
    """Return the step of the board's proportions, the larger one of both."""
    places = _places(len(images))
    found = board.likeliest((np.arange(len(images))[:, None] >= places).astype(float))
    largest = float(found.size[np.argmax(np.abs(found.size))])
    return Change(largest, found.clear(_independent(len(images))), images[int(places[found.index]) :])


def _two_boards(plain: _Linearised, images: tuple[str, ...]) -> TwoBoards:
    """Return the two groups of views, before and after a change or in any order, within which residuals correlate best,
    as seen on the board, and between which they do least.
    """
    px = _on_board(plain)
    seen = px != 0
    # what all views share is no change
    px = seen * (px - px.sum(axis=0) / np.maximum(seen.sum(axis=0), 1))
    lengths = np.maximum(np.linalg.norm(px, axis=1), 1e-300)
    alike = px @ px.T / lengths[:, None] / lengths
    np.fill_diagonal(alike, 0.0)
    groups = np.arange(len(images))[:, None] >= _places(len(images))
    clear = _contrast(alike, groups)
    best = int(np.argmax(clear))
    second, most = groups[:, best], float(clear[best])
    mixed = _two_clusters(alike)
    if mixed is not None and (any_order := float(_contrast(alike, mixed[:, None])[0]) - _CHOSEN) > most:
        second, most = mixed, any_order
    return TwoBoards(_distance(px, second), most, tuple(images[index] for index in np.flatnonzero(second)))


def _contrast(alike: Array, groups: Array) -> Array:
    """Return how much the correlations (V, V) of views are larger within groups than between them, in standard
    deviations; groups: (V, n) bool, the second group of n divisions.
    """
    contrast = groups - groups.mean(axis=0)
    # Pairs of views are uncorrelated if errors of views are independent, however large they are and of whatever kind;
    # but for what the common mean has taken away.
    total = np.sum(contrast * (alike @ contrast), axis=0) - np.sum(contrast**2, axis=0) / (len(alike) - 1)
    spread = np.sqrt(2 * np.sum(contrast**2 * (alike**2 @ contrast**2), axis=0))
    return np.asarray(total / np.maximum(spread, 1e-300))


def _two_clusters(alike: Array) -> Array | None:
    """Return the smaller of two groups (V,) into which the first principal component of the views falls, None where its
    values do not lie about two points.
    """
    values = np.linalg.eigh(alike)[1][:, -1]
    order = np.argsort(values)
    places = _places(len(values))
    behind = np.arange(len(values))[:, None] >= places
    size = behind.sum(axis=0)
    means = values[order] @ behind / size, values[order] @ ~behind / (len(values) - size)
    between = size * (len(values) - size) / len(values) * (means[0] - means[1]) ** 2
    best = int(np.argmax(between))
    if between[best] < _TWO_POINTS * np.sum((values - values.mean()) ** 2):
        return None
    result = np.zeros(len(values), bool)
    result[order[behind[:, best]]] = True
    return result if 2 * result.sum() <= len(values) else ~result


def _on_board(plain: _Linearised) -> Array:
    """Return the residuals (V, 3 C) px of points along x, y and z of the board, 0 for those not seen.

    Those along z are weighted by how far a height over the board moves a point of this view.
    """
    axes = plain.derivatives.by_board(plain.estimate.state.rotations)
    left, scale, right = np.linalg.svd(axes[..., :2])
    turned = np.empty((*plain.present.shape, 3))
    # the rotation (or reflection) next to the board's axes in the image: residuals keep their lengths
    turned[..., :2] = np.einsum("vpij,ivp->vpj", left @ right, plain.residuals)
    side = np.sqrt(np.maximum(scale[..., 0] * scale[..., 1], 1e-300))
    turned[..., 2] = np.einsum("vpi,ivp->vp", axes[..., 2], plain.residuals) / side
    turned *= np.sqrt(plain.weights)[..., None]
    problem = plain.estimate.problem
    places = np.zeros((len(turned), problem.board.count, 3))
    rows, columns = np.nonzero(plain.present)
    places[rows, problem.observations.ids[rows, columns]] = turned[rows, columns]
    return places.reshape(len(turned), -1)


def _distance(px: Array, second: Array) -> float:
    """Return the RMS distance of points between two groups of views: of residuals (V, 3 C), noise taken out by
    comparing different views only.
    """
    seen = (px.reshape(len(px), -1, 3) != 0).any(axis=2).astype(float)
    common = seen @ seen.T
    products, pairs = px @ px.T / np.maximum(common, 1), common >= _COMMON
    np.fill_diagonal(pairs, val=False)

    def mean(one: Array, other: Array) -> float:
        both = pairs & one[:, None] & other
        return float(products[both].mean()) if both.any() else 0.0

    return float(np.sqrt(max(mean(second, second) + mean(~second, ~second) - 2 * mean(second, ~second), 0.0)))


def _blurred(full: _Linearised, images: tuple[str, ...]) -> tuple[Blur, ...]:
    """Return the views whose residuals scatter more in one direction than they would by chance, the most first.

    The chance of a ratio of variances is that of the likelihood ratio for equal ones (Mauchly's sphericity).
    """
    weights, residuals = full.weights, full.residuals
    count = np.maximum(weights.sum(axis=1), 1e-300)
    scatter = np.einsum("vp,ivp,jvp->vij", weights, residuals, residuals) / count[:, None, None]
    across, along = np.maximum(np.linalg.eigvalsh(scatter), 1e-12).T
    typical = float(np.median((across + along) / 2))
    unlikely = count * np.log((across + along) ** 2 / (4 * across * along)) > 2 * np.log(len(images) / _CHANCE)
    ratio = along / np.maximum(across, typical)
    order = [int(index) for index in np.argsort(-ratio) if unlikely[index]]
    return tuple(Blur(images[index], float(np.sqrt(along[index])), float(ratio[index])) for index in order)
