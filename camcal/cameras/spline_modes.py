"""A spline in few parameters: those of a lens model that it starts from, and shapes of what the lens differs by.

The knots of a spline are many, redundant with fx fy cx cy, and undetermined where nothing is seen. A calibration
estimates p instead, of which the knots are a linear function θ = θ₀ + B (p - p₀). The first of p are the parameters of
the base lens: to first order, the knots follow it. The others are the amplitudes of shapes (modes) of what the lens
differs by. A difference is beforehand a Gaussian field of standard deviation τ over the plane, correlated over a few
knots, independent in x and y. Its modes are those directions that vary most beforehand for what the corners determine
of them: with the weights W of the knots around all corners, G = WᵀW, and the prior covariance C = L Lᵀ, the
eigenvectors of Lᵀ G L. What they share with the base lens and with rotations of the camera is taken out, over the
corners, so that neither is a gauge. Where nothing is seen, a difference fades to zero and the base lens is left.
"""

import math
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.cameras.lens import CameraModel, Domain, Projection, ProjectionJacobians, Rays
from camcal.cameras.model import Camera
from camcal.cameras.plane_model import CORE
from camcal.cameras.spline import Knots, SplinedStereographic
from camcal.dataclass import dataclass, field
from camcal.geometry import rotation as so3

_PER_KNOT = 4  # samples of the base lens, across and down
_SMOOTH = 1e-7  # of the curvature of knots against the misfit at samples: what no sample determines
_AROUND, _FAR_WEIGHT = 1.05, 1e-3  # of the outermost corner; the base lens may be steep beyond
_RANGE = 4.0  # knots over which differences are correlated
_FEWEST_SHARE = 1e-7  # of the largest eigenvalue: modes that corners hardly see
_MOST_MODES = 60  # for each axis
_RADIAL = 5.0  # by how much lenses differ from their base alike all around, over by how much they do to one side
_TILE = 256  # points that are transposed at a time, which stay in the cache


@dataclass(frozen=True, eq=False)
class _ByModes(ProjectionJacobians):
    """Derivatives by the knots θ, of which those by p are made where they are asked for: poses alone do without."""

    basis: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    def by_parameters(self, count: int) -> Array:  # noqa: ARG002
        """Return the derivatives (N, 2, P) by p."""
        assert self.columns is not None
        core, taps = len(CORE), (self.d_parameters.shape[2] - len(CORE)) // 2
        local, first = self.d_parameters.transpose(1, 2, 0), self.columns[:, core]
        found = np.empty((2, self.basis.shape[1], len(first)))
        found[:, :core] = local[:, :core]
        order = np.argsort(first, kind="stable")  # points of a cell side by side
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        ends = np.append(np.flatnonzero(np.diff(first[order])) + 1, len(order))
        moved = np.empty((len(first), self.basis.shape[1] - core))
        for axis, rows in enumerate(found[:, core:]):
            own = slice(core + axis * taps, core + (axis + 1) * taps)
            weights = np.ascontiguousarray(local[axis, own].T)[order]
            for start, end in zip((0, *ends[:-1]), ends if len(order) else (), strict=False):
                cell = self.columns[order[start], own]
                np.matmul(weights[start:end], self.basis[cell, core:], out=moved[start:end])
            for start in range(0, len(moved), _TILE):
                rows[:, start : start + _TILE] = moved[place[start : start + _TILE]].T
        return found.transpose(2, 0, 1)


@dataclass(frozen=True, eq=False)
class ReducedSpline:
    """The lens model of p.

    base: the lens model that it starts from. start_values: (p₀) of base, then zeros. knots: (K,) θ₀. basis: (K, P) B.
    unseen: (n, n) the prior covariance of knots in units of τ² without the modes'. spread: τ in units of the plane.
    noise_ratio: by how much the variance of errors that views have by chance is larger than noise would have it, so
    that modes are held to zero by so much more.
    """

    spline: SplinedStereographic
    base: CameraModel
    start_values: Array = field(repr=False)
    knots: Array = field(repr=False)
    basis: Array = field(repr=False)
    unseen: Array = field(repr=False)
    spread: float = 1.0
    noise_ratio: float = 1.0

    @property
    def name(self) -> str:
        return self.spline.name

    @property
    def aliases(self) -> tuple[str, ...]:
        return self.spline.aliases

    @property
    def summary(self) -> str:
        return self.spline.summary

    @property
    def is_view(self) -> bool:
        return False

    @property
    def is_central(self) -> bool:
        return True

    @property
    def opencv(self) -> str:
        return ""

    @property
    def first_mode(self) -> int:
        """How many of the parameters are those of the base lens."""
        return len(self.base.parameter_names)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        modes = range(self.basis.shape[1] - self.first_mode)
        return self.base.parameter_names + tuple(f"mode {index}" for index in modes)

    @property
    def stages(self) -> tuple[tuple[str, ...], ...]:
        return self.base.stages

    @property
    def colour_stages(self) -> tuple[tuple[str, ...], ...]:
        return self.base.colour_stages

    @cached_property
    def prior_mean(self) -> Array:
        return np.pad(self.base.prior_mean, (0, len(self.parameter_names) - self.first_mode))

    @property
    def typical(self) -> Mapping[str, float]:
        return {}

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:
        return dict.fromkeys(self.parameter_names, (-math.inf, math.inf))

    @property
    def configuration(self) -> Mapping[str, object]:
        return self.spline.configuration

    def configured(self, configuration: Mapping[str, object]) -> CameraModel:
        """Return the spline with other knots."""
        return self.spline.configured(configuration)

    def knots_of(self, parameters: Array) -> Array:
        """Return the parameters θ (K,) of the spline."""
        return np.asarray(self.knots + self.basis @ (parameters - self.start_values))

    def project(self, parameters: Array, points: Array) -> Projection:
        """Return the pixels (N, 2) of points (N, 3) in the camera frame."""
        return self.spline.project(self.knots_of(parameters), points)

    def project_with_jacobians(
        self, parameters: Array, points: Array, *, within_domain: bool = True
    ) -> ProjectionJacobians:
        """Return the pixels of points (N, 3) with their derivatives by points and by p (N, 2, P)."""
        found = self.spline.project_with_jacobians(self.knots_of(parameters), points, within_domain=within_domain)
        return _ByModes(found.pixels, found.valid, found.d_point, found.d_parameters, found.columns, self.basis)

    def unproject(self, parameters: Array, pixels: Array) -> Rays:
        """Return the unit rays (N, 3) of pixels (N, 2)."""
        return self.spline.unproject(self.knots_of(parameters), pixels)

    def domain(self, parameters: Array) -> Domain:
        """Return where the spline is one-to-one."""
        return self.spline.domain(self.knots_of(parameters))

    def is_pinhole(self, parameters: Array) -> bool:  # noqa: ARG002
        return False

    def rescale(self, parameters: Array, scale: tuple[float, float], offset: tuple[float, float]) -> Array:
        """Return the parameters (P,) for an image resized by `scale` (x, y), then cropped at `offset` (x, y) px."""
        lens = self.base.rescale(parameters[: self.first_mode], scale, offset)
        return np.concatenate([lens, parameters[self.first_mode :]])

    def start(self, image_size: tuple[int, int], focal: float) -> Array:  # noqa: ARG002
        """Return the parameters (P,) of the base lens."""
        return self.start_values.copy()

    def prior_std(self, image_size: tuple[int, int], focal: float) -> Array:
        """Return the standard deviations (P,) of the priors: the base lens's weak ones, and τ of every mode."""
        modes = np.full(len(self.parameter_names) - self.first_mode, self.spread / math.sqrt(self.noise_ratio))
        return np.concatenate([self.base.prior_std(image_size, focal), modes])

    def camera(self, image_size: tuple[int, int], parameters: Array, covariance: Array) -> Camera:
        """Return the camera of the spline itself; covariance: (P, P).

        What the corners do not determine of the knots has the covariance that it has beforehand.
        """
        own = self.basis @ covariance @ self.basis.T
        for axis in range(2):
            own[len(CORE) + axis :: 2, len(CORE) + axis :: 2] += self.spread**2 * self.unseen
        return Camera(self.spline, image_size, self.knots_of(parameters), (own + own.T) / 2)


def reduced_spline(base: Camera, rays: Array, weights: Array, spline: SplinedStereographic) -> ReducedSpline:
    """Return a spline that starts as a lens of a parametric model, with the modes that corners see.

    rays: (M, 3) of the corners in the camera frame. weights: (M,) how much they count. Its spread is 1.
    """
    grid = spline.grid
    operator = _KnotFit.of(grid)
    samples = base.model.project_with_jacobians(base.parameters, operator.rays, within_domain=True)
    known = samples.valid
    focal, centre = base.parameters[:2], base.parameters[2:4]
    # by rotations and by all parameters of the base lens, in units of the plane
    by_turn = samples.d_point @ -so3.hat(operator.rays)
    by_base = samples.by_parameters(len(base.parameters))
    fields = np.concatenate([(samples.pixels - centre)[:, :, None], by_base, by_turn], axis=2) / focal[None, :, None]
    fields[:, :, 0] -= operator.places
    places = _on_plane(rays)
    near = np.hypot(*operator.places.T) <= _AROUND * np.hypot(*places.T).max()
    fitted = operator.fit(np.nan_to_num(fields), known * np.where(near, 1.0, _FAR_WEIGHT))
    origin, of_base, shared = fitted[:, :, 0], fitted[:, :, 5 : 1 + len(base.parameters)], fitted[:, :, 1:]
    gram = _gram(grid, places, weights)
    modes, unseen = _modes(grid, gram)
    count, core = modes.shape[1], len(CORE)
    radial = _RADIAL * operator.fit(_radial_fields(grid, operator.places), np.ones(len(operator.places)))
    both = np.zeros((len(modes), 2, 2 * count))
    both[:, 0, :count] = both[:, 1, count:] = modes
    both = np.concatenate([both, radial], axis=2)
    # out of the modes what they share with base lens and rotations, over the corners
    seen = np.einsum("ij,jak->iak", gram, shared).reshape(-1, shared.shape[2])
    flat, wide = shared.reshape(-1, shared.shape[2]), both.reshape(-1, both.shape[2])
    scale = np.sqrt(np.maximum(np.einsum("ik,ik->k", flat, seen), np.finfo(float).tiny))
    shares = np.linalg.lstsq((flat / scale).T @ (seen / scale), (seen / scale).T @ wide, rcond=1e-9)[0]
    both = (wide - (flat / scale) @ shares).reshape(both.shape)
    knots = np.concatenate([[*focal, *centre], origin.ravel()])
    basis = np.zeros((len(knots), len(base.parameters) + both.shape[2]))
    basis[:core, :core] = np.eye(core)
    basis[core:, core : len(base.parameters)] = of_base.reshape(len(knots) - core, -1)
    basis[core:, len(base.parameters) :] = both.reshape(len(knots) - core, -1)
    start = np.concatenate([base.parameters, np.zeros(both.shape[2])])
    return ReducedSpline(spline, base.model, start, knots, basis, unseen)


@dataclass(frozen=True, eq=False)
class _KnotFit:
    """Least squares from values at samples of the plane to knots."""

    grid: Knots
    places: Array
    rays: Array
    design: Array
    curvature: Array

    @classmethod
    def of(cls, grid: Knots) -> "_KnotFit":
        columns, rows = grid.counts
        axes = [
            np.linspace(-half, half, _PER_KNOT * (count - 1) + 1)
            for half, count in zip(grid.half, grid.counts, strict=True)
        ]
        places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        quarter = 0.25 * (places**2).sum(axis=1)
        rays = np.column_stack([places, 1 - quarter]) / (1 + quarter)[:, None]
        across, down = (np.diff(np.eye(count), 2, axis=0) for count in (columns, rows))
        bends = np.concatenate([np.kron(np.eye(rows), across), np.kron(down, np.eye(columns))])
        return cls(grid, places, rays, _design(grid, places), bends.T @ bends)

    def fit(self, values: Array, weights: Array) -> Array:
        """Return the knots (n, …) of values (N, …) at the samples, which count by weights (N,)."""
        design, flat = self.design * weights[:, None], values.reshape(len(values), -1)
        normal = self.design.T @ design
        normal += _SMOOTH * np.trace(normal) / len(normal) * self.curvature
        return np.linalg.solve(normal, design.T @ flat).reshape(-1, *values.shape[1:])


def _design(grid: Knots, places: Array) -> Array:
    """Return the weights (N, n) of all knots at places (N, 2)."""
    columns, weights = _weights(grid, places)
    result = np.zeros((len(places), grid.counts[0] * grid.counts[1]))
    np.put_along_axis(result, columns, weights, axis=1)
    return result


def _weights(grid: Knots, places: Array) -> tuple[Array, Array]:
    """Return the knots (N, taps) around places (N, 2) and their weights."""
    near = grid.around(places[:, 0], places[:, 1])
    size = grid.degree + 1
    offsets = (grid.counts[0] * np.arange(size)[:, None] + np.arange(size)).ravel()
    weights = np.stack(near.down)[:, None] * np.stack(near.across)[None]
    return near.first[:, None] + offsets, weights.reshape(size * size, -1).T


def _on_plane(rays: Array) -> Array:
    """Return the places (M, 2) of rays (M, 3) on the plane."""
    return np.asarray(2 * rays[:, :2] / (np.linalg.norm(rays, axis=1) + rays[:, 2])[:, None])


def _gram(grid: Knots, places: Array, weights: Array) -> Array:
    """Return WᵀW (n, n) of the weights of knots around places (M, 2)."""
    columns, found = _weights(grid, places)
    found *= np.sqrt(weights)[:, None]
    order = np.argsort(columns[:, 0], kind="stable")
    starts = np.flatnonzero(np.diff(columns[order, 0], prepend=-1))
    count = grid.counts[0] * grid.counts[1]
    result = np.zeros((count, count))
    for cell in np.split(order, starts[1:]):
        knots = columns[cell[0]]
        result[np.ix_(knots, knots)] += found[cell].T @ found[cell]
    return result


def _modes(grid: Knots, gram: Array) -> tuple[Array, Array]:
    """Return the modes (n, m) of a difference along an axis, of prior variance 1 in the middle of the plane, and the
    prior covariance (n, n) of what they leave out.

    The prior is a Matérn field of smoothness 2 by its stochastic differential equation (κ² - Δ)^(3/2) x = white noise
    over the knots. Source: Lindgren, Rue & Lindström, JRSS B 73, 2011.
    """
    columns, rows = grid.counts
    slopes = [np.diff(np.eye(count), axis=0) for count in (columns, rows)]
    laplacian = np.kron(np.eye(rows), slopes[0].T @ slopes[0]) + np.kron(slopes[1].T @ slopes[1], np.eye(columns))
    values, vectors = np.linalg.eigh(laplacian)
    root = vectors * (values + 16 / _RANGE**2) ** -1.5  # a range of √(8 ν) / κ
    middle = _design(grid, np.zeros((1, 2)))[0] @ root
    root /= np.linalg.norm(middle)
    strength, turned = np.linalg.eigh(root.T @ gram @ root)
    chosen = np.flatnonzero(strength > _FEWEST_SHARE * strength[-1])[-_MOST_MODES:][::-1]
    modes = root @ turned[:, chosen]
    return modes, root @ root.T - modes @ modes.T


def _radial_fields(grid: Knots, places: Array) -> Array:
    """Return the modes (N, 2, m) at places (N, 2) of a difference that is alike all around, of prior variance 1.

    Along the radius it is an odd Matérn field of smoothness 2, (κ² - d²/dr²)^(5/4) x = white noise, of which these are
    the waves that knots can follow.
    """
    radius = np.hypot(*places.T)
    reach = radius.max()
    waves = np.pi / reach * (np.arange(int(reach * grid.per_unit)) + 0.5)
    stds = (16 * (grid.per_unit / _RANGE) ** 2 + waves**2) ** -1.25
    along = np.sin(radius[:, None] * waves) * stds * np.sqrt(2 / np.sum(stds**2))
    outwards = places / np.maximum(radius, np.finfo(float).tiny)[:, None]
    return np.asarray(outwards[:, :, None] * along[:, None, :])
