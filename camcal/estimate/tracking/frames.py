"""What single frames say of their poses: costs of pixels or of poses, with derivatives, and descents on them.

Poses between what a frame says and what was expected of it are found from many starts at once: the cost of the frame
plus χ² of the step from the expected pose is descended, to begin with as if wrong pixels were right.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from typing import ClassVar, NamedTuple, Self

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.dataclass import dataclass, replace
from camcal.estimate.poses.problem import Anchor
from camcal.estimate.poses.records import Correspondences
from camcal.estimate.poses.states import retract, stacked, steps_from
from camcal.estimate.tracking.measurements import PoseMeasurements
from camcal.estimate.tracking.motion import POSE, VELOCITY, MotionState
from camcal.solve.descent import Stopping
from camcal.solve.independent import Minima, Models, Trial, minimise_each

WRONG = 0.02  # share of parts that belong to something else
_LEAST_DEPTH = 1e-9
_BEHIND = 1e3  # squared deviations of a point behind the camera
_NOWHERE = 1e3  # squared deviations of a pose that is near no minimum

# descents
_STOPPING = Stopping(iterations=12, damping=1e-3, least=0.2, most=1e3)
_TEMPERATURES = (16.0, 4.0)
_SETTLED = 1e-3  # of half the cost: a difference that is as good as none
_TINY = 1e-12
_SAME = 1.0  # squared Mahalanobis distance of ends that are one
_SAME_TURN = 0.2  # rad, no more than which they are apart


@dataclass(frozen=True, eq=False)
class FrameCosts(ABC):
    """What N frames say of their poses, in up to P parts each: the pixels of points, or one pose.

    there: (N, P) the parts that frames have. floors: (N, P) likelihood of a wrong part over that of a perfect one.
    coordinates: the numbers that a part measures. divided: the powers of a factor on their noise that fields are
    divided by. repeated: the error of a frame's -2 ln likelihood that others which show the same have too, over what
    noise does to it; 0 where the likelihood is that of the measurement. overstated_ahead: by how much -2 ln of the
    evidence is too large for hypotheses that know some frames only, by the noise of a first pass.
    """

    there: Array
    floors: Array
    coordinates: ClassVar[int]
    divided: ClassVar[dict[str, int]]
    repeated: ClassVar[float] = 0.0
    overstated_ahead: ClassVar[float] = 2.0  # docs/mathematics.md

    @abstractmethod
    def squares(self, rotations: Array, translations: Array) -> Array:
        """Return the squared deviations (..., P) of the parts of frames from what poses (...) predict."""

    @abstractmethod
    def linearised(self, rotations: Array, translations: Array, temper: float = 1.0) -> tuple[Array, Array, Array]:
        """Return the cost (...) of poses, half its gradient (..., 6) and half its curvature (..., 6, 6).

        Steps are tx ty tz rx ry rz with R ← Exp(δr) R. The curvature is that of Gauss and Newton, wrong parts left out
        by their weights. temper: more than 1 gives weight to parts that are so many times farther off (squared), to
        begin with; the cost is not changed by it.
        """

    def __len__(self) -> int:
        return len(self.there)

    def at(self, frames: Array | int) -> Self:
        """Return some of the frames, or one without the first axis."""
        return type(self)(**{field.name: getattr(self, field.name)[frames] for field in fields(self)})

    def with_noise(self, factor: float) -> Self:
        """Return the frames with the standard deviations of what they measure times a factor."""
        divided = {name: getattr(self, name) / factor**power for name, power in self.divided.items()}
        return replace(self, floors=self.floors * factor**self.coordinates, **divided)

    def inlier_probabilities(self, squared: Array) -> Array:
        """Return the probabilities (..., P) that parts belong to the object, by squared deviations; 0 where none is."""
        near = np.exp(-squared / 2)
        return np.asarray(np.where(self.there, near / (near + getattr(self, "gates", self.floors)), 0.0))


@dataclass(frozen=True, eq=False)
class PixelFrames(FrameCosts):
    """The points of an object and their pixels in N frames of up to P points, zeros where a frame has fewer.

    A pixel is compared with its point on the plane that touches the unit sphere at the pixel's ray, so that any lens is
    a pinhole there: e = A p / (r · p), A = L⁻¹ D B, B two directions across the ray r, D what a pixel moves per step
    along them, L the root of the pixel's covariance. Wrong pixels are uniform over the image:
    cost = -2 ln[(1 - ε) exp(-e²/2) + ε 2π |C|^½ / area], 0 for e = 0.

    points: (N, P, 3). projections: (N, P, 2, 3) A, with a noise of 1. rays: (N, P, 3) unit.
    """

    points: Array
    projections: Array
    rays: Array
    coordinates: ClassVar[int] = 2
    divided: ClassVar[dict[str, int]] = {"projections": 1}

    @classmethod
    def of(cls, camera: Camera, views: Sequence[Correspondences | None], sigma: float) -> "PixelFrames":
        """Return the frames of views, None for frames without the object.

        sigma: standard deviation of a pixel coordinate, px; of covariances the root of their factor.
        """
        table = Observations.of(views, unknown=np.eye(2))
        shape, there = table.ids.shape, table.present.copy()
        points = table.padded([None if view is None else view.points for view in views], 3).transpose(1, 2, 0)
        pixels = table.pixels.transpose(1, 2, 0)
        covariance = np.tile(np.eye(2), (*shape, 1, 1)) if table.covariance is None else table.covariance
        roots = np.linalg.cholesky(covariance)
        rays = np.tile([0.0, 0.0, 1.0], (*shape, 1))
        projections = np.zeros((*shape, 2, 3))
        found = camera.unproject(pixels[there])
        there[there] = found.valid
        rays[there] = found.directions[found.valid]
        across = _across(rays[there])
        seen = camera.model.project_with_jacobians(camera.parameters, rays[there], within_domain=False)
        per_step = seen.d_point @ across.swapaxes(-1, -2)
        whitening = np.linalg.inv(roots[there] * sigma)
        projections[there] = whitening @ per_step @ across
        usable = np.isfinite(projections).all(axis=(-1, -2))
        there &= usable
        projections[~usable] = 0.0
        area = float(np.prod(camera.image_size))
        spread = 2 * np.pi * sigma**2 * np.sqrt(np.linalg.det(roots @ roots.swapaxes(-1, -2)))
        return cls(there, WRONG / (1 - WRONG) * spread / area, points=points, projections=projections, rays=rays)

    @property
    def counts(self) -> Array:
        """The number (N,) of points in every frame."""
        return np.asarray(self.there.sum(axis=1))

    def squares(self, rotations: Array, translations: Array) -> Array:
        """Return the squared deviations (..., P) of the pixels of frames from what poses (...) predict."""
        seen = self.points @ rotations.swapaxes(-1, -2) + translations[..., None, :]
        depth = (seen * self.rays).sum(axis=-1)
        off = (self.projections @ seen[..., None])[..., 0]
        front = depth > _LEAST_DEPTH
        result = (off**2).sum(axis=-1) / np.where(front, depth, 1.0) ** 2
        return np.asarray(np.where(front, result, _BEHIND) * self.there)

    def linearised(self, rotations: Array, translations: Array, temper: float = 1.0) -> tuple[Array, Array, Array]:
        """Return the cost of poses with its derivatives, see FrameCosts."""
        turned = self.points @ rotations.swapaxes(-1, -2)
        seen = turned + translations[..., None, :]
        depth = (seen * self.rays).sum(axis=-1)
        front = (depth > _LEAST_DEPTH) & self.there
        depth = np.where(front, depth, 1.0)
        off = (self.projections @ seen[..., None])[..., 0] / depth[..., None]
        squared = np.where(front, (off**2).sum(axis=-1), _BEHIND * self.there)
        floors = self.floors
        near = np.exp(-squared / 2)
        cost = np.where(self.there, -2 * np.log((near + floors) / (1 + floors)), 0.0).sum(axis=-1)
        if temper != 1.0:
            near = np.exp(-squared / (2 * temper))
        root = np.sqrt(np.where(front, near / (near + floors), 0.0))
        slopes = (self.projections - off[..., None] * self.rays[..., None, :]) * (root / depth)[..., None, None]
        jacobian = np.empty((*slopes.shape[:-1], 6))
        jacobian[..., :3] = slopes
        arm = turned[..., None, :]
        for axis, (one, other) in enumerate(((1, 2), (2, 0), (0, 1))):
            jacobian[..., 3 + axis] = arm[..., one] * slopes[..., other] - arm[..., other] * slopes[..., one]
        rows = jacobian.reshape(*jacobian.shape[:-3], -1, 6)
        weighted = (off * root[..., None]).reshape(*rows.shape[:-1], 1)
        across = rows.swapaxes(-1, -2)
        return cost, (across @ weighted)[..., 0], across @ rows


def _across(rays: Array) -> Array:
    """Return two unit directions (M, 2, 3) across each ray (M, 3) and each other."""
    helper = np.where(np.abs(rays[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    first = np.cross(rays, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(rays, first)], axis=1)


@dataclass(frozen=True, eq=False)
class PoseFrames(FrameCosts):
    """The poses that N frames allow, up to C each.

    Each minimum of a frame counts by the normal density and the χ² that it has, so that both branches of a plane speak;
    or the frame's pose is wrong, and the true one anywhere: cost = -2 ln[Σ exp(-(Δχ² + dᵀ Σ⁻¹ d)/2) + ε], up to a
    constant, d the step from a minimum with covariance Σ.

    rotations: (N, C, 3, 3). translations: (N, C, 3). information: (N, C, 6, 6) inverse covariances. penalties: (N, C)
    Δχ², infinite where there is none. gates: (N, 1) likelihood below which a pose is refused.
    """

    rotations: Array
    translations: Array
    information: Array
    penalties: Array
    gates: Array
    coordinates: ClassVar[int] = 6
    divided: ClassVar[dict[str, int]] = {"information": 2, "penalties": 2}
    # Near the frontal view a normal density is not the likelihood (docs/mathematics.md).
    repeated: ClassVar[float] = 0.2
    overstated_ahead: ClassVar[float] = 4.0

    @classmethod
    def of(cls, measurements: PoseMeasurements, unknown: Array, gate: float) -> "PoseFrames":
        """Return the frames of measurements; unknown: (S,) variances of an unknown state. gate: bound of χ²."""
        there = measurements.present[:, None]
        information = np.linalg.inv(measurements.covariances)
        # A wrong pose may be as far off as an unknown velocity leads: else no track begins where frames are rare.
        since = np.zeros((len(there), 1))
        since[np.flatnonzero(there)[1:], 0] = np.diff(measurements.stamps[there[:, 0]])
        spread = unknown[POSE] + unknown[VELOCITY] * since**2
        volumes = np.linalg.slogdet(np.eye(6) + spread[:, None, :, None] * information[:, :1])[1]
        return cls(
            there,
            WRONG * np.exp(-volumes / 2),
            rotations=measurements.rotations,
            translations=measurements.translations,
            information=information,
            penalties=measurements.penalties,
            gates=np.full(there.shape, np.exp(-gate / 2)),
        )

    def squares(self, rotations: Array, translations: Array) -> Array:
        """Return the squared deviations (..., 1) of frames from poses (...), of all their minima together."""
        squared, _, _ = self._deviations(rotations, translations)
        squared = np.minimum(-2 * np.logaddexp.reduce(-squared / 2, axis=-1, keepdims=True), _NOWHERE)
        return np.asarray(squared * self.there)

    def linearised(self, rotations: Array, translations: Array, temper: float = 1.0) -> tuple[Array, Array, Array]:
        """Return the cost of poses with its derivatives, see FrameCosts."""
        squared, pulls, slopes = self._deviations(rotations, translations)
        near = np.exp(-squared / 2)
        cost = -2 * np.log((near.sum(axis=-1, keepdims=True) + self.floors) / (1 + self.floors))
        if temper != 1.0:
            near = np.exp(-squared / (2 * temper))
        weights = near / (near.sum(axis=-1, keepdims=True) + self.floors)
        across = slopes.swapaxes(-1, -2)
        gradient = (weights[..., None] * (across @ pulls[..., None])[..., 0]).sum(axis=-2)
        curvature = (weights[..., None, None] * (across @ self.information @ slopes)).sum(axis=-3)
        return np.where(self.there, cost, 0.0)[..., 0], gradient, curvature

    def _deviations(self, rotations: Array, translations: Array) -> tuple[Array, Array, Array]:
        """Return χ² (..., C) of poses at each minimum, Σ⁻¹ d (..., C, 6) and the slopes (..., C, 6, 6) of d."""
        steps, slopes = steps_from(
            rotations[..., None, :, :], translations[..., None, :], self.rotations, self.translations
        )
        pulls = (self.information @ steps[..., None])[..., 0]
        return self.penalties + (steps * pulls).sum(axis=-1), pulls, slopes


class DescentResults(NamedTuple):
    """Where descents ended: the hypothesis (E) each stems from, the cost, and the steps (E, 6) from what it expected.

    slopes: (E, 6, 6) of the steps over steps of the pose. normal: (E, 6, 6) half the curvature of the whole cost, of
    the pixels and of what was expected.
    """

    parents: Array
    costs: Array
    steps: Array
    slopes: Array
    normal: Array


def descend_frame(frame: FrameCosts, middles: MotionState, covariances: Array, starts: MotionState) -> DescentResults:
    """Return the distinct ends of descents on a frame's pixels and on what was expected of its pose.

    middles, covariances: (K, 6, 6) of what K hypotheses expect. starts: (K C), those of each hypothesis together.
    """
    count = len(covariances)
    parents = np.repeat(np.arange(count), len(starts.translations) // count)
    middle = middles.at(parents)
    anchor = Anchor(stacked(middle.rotations, middle.translations), np.linalg.inv(covariances)[parents])
    descent = _Descent(frame, anchor)
    ends = descent.minima(descent.approach(stacked(starts.rotations, starts.translations)))
    step, slope = steps_from(ends.states[:, :, :3], ends.states[:, :, 3], middle.rotations, middle.translations)
    return _distinct(DescentResults(parents, 2 * ends.cost, step, slope, ends.models.normal))


def frame_minima(frames: FrameCosts, rotations: Array, translations: Array) -> Array:
    """Return the costs (N) of the minima of N frames next to poses (N, 3, 3), (N, 3)."""
    descent = _Descent(frames)
    states = stacked(rotations, translations)
    near = descent.approach(states)
    worse = frames.linearised(near[:, :, :3], near[:, :, 3])[0] > frames.linearised(rotations, translations)[0]
    return np.asarray(2 * descent.minima(np.where(worse[:, None, None], states, near)).cost)


@dataclass(frozen=True, eq=False)
class _Descent:
    """The searches for poses (S, 3, 4) by what one frame says, or each by its own, and by what was expected of them.

    Costs are half of those of frames, as the solver has them.
    """

    frames: FrameCosts
    expected: Anchor | None = None

    def linearise(self, states: Array, which: Array, temper: float = 1.0) -> Models:
        frames = self.frames if self.frames.there.ndim == 1 else self.frames.at(which)
        cost, gradient, normal = frames.linearised(states[:, :, :3], states[:, :, 3], temper)
        if self.expected is None:
            return Models(cost / 2, gradient, normal)
        prior = self.expected.models(states, which)
        return Models(cost / 2 + prior.cost, gradient + prior.gradient, normal + prior.normal)

    def retract(self, states: Array, steps: Array) -> Array:
        return retract(states, steps)

    def approach(self, states: Array) -> Array:
        """Return states after steps by which pixels count that are farther off, as wrong ones are."""
        which = np.arange(len(states))
        for temper in _TEMPERATURES:
            models = self.linearise(states, which, temper)
            diagonal = np.einsum("sii->si", models.normal)
            diagonal *= 1 + _STOPPING.damping
            diagonal += _TINY * (1 + diagonal.sum(axis=1, keepdims=True))  # of a frame whose pixels are all wrong
            states = retract(states, -np.linalg.solve(models.normal, models.gradient[..., None])[..., 0])
        return states

    def minima(self, states: Array) -> Minima:
        """Return the minima that states lead to."""
        return minimise_each(self, states, np.arange(len(states)), _STOPPING, enough=_enough)


def _enough(trial: Trial) -> Array:
    """Return whether steps (A,) did what the quadratic model promised, which then has no more to promise."""
    return np.asarray(trial.taken & (np.abs(trial.promised - trial.fall) <= _SETTLED))


def _distinct(ends: DescentResults) -> DescentResults:
    """Return the ends without those that another one of the same hypothesis is as good as."""
    order = np.lexsort((ends.costs, ends.parents))
    kept: list[int] = []
    for index in order:
        one = int(index)
        for other in kept:
            if ends.parents[other] == ends.parents[one]:
                apart = ends.steps[one] - ends.steps[other]
                if apart @ ends.normal[other] @ apart < _SAME and np.abs(apart[3:]).max() < _SAME_TURN:
                    break
        else:
            kept.append(one)
    return DescentResults(*(part[kept] for part in ends))
