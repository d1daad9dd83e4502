"""The pose of an object from its points and their pixels, with covariance and the pose it may be mistaken for.

Every start is refined to its minimum of the reprojection error through the package's solver; the lowest one wins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array, readonly
from camcal.cameras.model import Camera
from camcal.errors import CamcalError, InsufficientData, InvalidInput
from camcal.estimate.planar import Extent
from camcal.estimate.pose_minima import MIN_POINTS, ROUNDING, pose_minima
from camcal.estimate.pose_problem import PoseProblem
from camcal.geometry.pose import Pose, inverse_jacobian
from camcal.progress import Outcome
from camcal.solve.least_squares import Solution
from camcal.solve.losses import Loss

CAMERA_T_OBJECT = "camera_T_object"
AMBIGUOUS = 0.01  # leaves 0.04 % wrong poses among small, far tags
_COLLINEAR = 1e-6  # second spread over the first
_SINGULAR = 1e-10  # smallest eigenvalue of the scaled normal matrix


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points (N, 3) of an object and the pixels (N, 2) at which one image shows them.

    covariance: (N, 2, 2) px² of the pixels, up to a common factor; None for equal ones. Raises InvalidInput unless
    every number is finite and every covariance positive.
    """

    image: str
    points: Array
    pixels: Array
    covariance: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", readonly(self.points, (None, 3), "points"))
        object.__setattr__(self, "pixels", readonly(self.pixels, (len(self.points), 2), "pixels"))
        if not (np.isfinite(self.points).all() and np.isfinite(self.pixels).all()):
            raise InvalidInput("a point or pixel is not a finite number", where=self.image)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (len(self.points), 2, 2), "covariance"))
            if not np.all(np.linalg.eigvalsh(self.covariance) > 0):
                raise InvalidInput("the covariance of a pixel is not positive", where=self.image)

    def take(self, chosen: Array) -> "Correspondences":
        """Return some of the points."""
        covariance = None if self.covariance is None else self.covariance[chosen]
        return Correspondences(self.image, self.points[chosen], self.pixels[chosen], covariance)


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another minimum: its pose, how much larger its χ² is, and the probability that it is the true one."""

    transform: Pose
    chi_square_difference: float
    probability: float


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The pose of one view and what is known of its quality.

    frames: what `transform` maps, camera_T_object or object_T_camera. covariance: (6, 6) of its steps, order
    tx ty tz rx ry rz (points' unit, rad), R ← Exp(δr) R, t ← t + δt.
    residuals: (N, 2) px, projected minus observed, NaN for points outside the lens's domain, which are left out.
    sigma_px: noise of a pixel coordinate (with covariances their factor's root); freedom: the degrees of freedom it
    was estimated with, None if it was given. reason: why the solver stopped.
    """

    frames: str
    transform: Pose
    covariance: Array
    residuals: Array
    sigma_px: float
    freedom: int | None
    alternative: Alternative | None
    converged: bool
    reason: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", readonly(self.covariance, (6, 6), "covariance"))
        object.__setattr__(self, "residuals", readonly(self.residuals, (None, 2), "residuals"))

    @property
    def used(self) -> int:
        """The number of points that count."""
        return int(np.count_nonzero(np.isfinite(self.residuals[:, 0])))

    @property
    def rms_px(self) -> float:
        """The root mean square of the distances between projected and observed pixels."""
        return float(np.sqrt(np.nansum(self.residuals**2) / self.used))

    @property
    def p_wrong(self) -> float:
        """The probability that the alternative is the true pose; 0 without one."""
        return self.alternative.probability if self.alternative else 0.0

    @property
    def status(self) -> str:
        """Whether the pose is to be trusted, in words that begin with ok, ambiguous or not converged."""
        if not self.converged:
            return f"not converged: {self.reason}"
        if self.p_wrong > AMBIGUOUS:
            return f"ambiguous: another pose fits nearly as well, probability {self.p_wrong:.2g}"
        return "ok"

    def inverse(self) -> "PoseEstimate":
        """Return the same estimate of the transform in the other direction."""
        jacobian = inverse_jacobian(self.transform)
        other = self.alternative
        return replace(
            self,
            frames="_T_".join(reversed(self.frames.split("_T_"))),
            transform=self.transform.inverse(),
            covariance=jacobian @ self.covariance @ jacobian.T,
            alternative=other and replace(other, transform=other.transform.inverse()),
        )


@dataclass(frozen=True, eq=False)
class _Fit:
    """The minima of one view, lowest first, and the mask (N,) of the points that took part."""

    view: Correspondences
    problem: PoseProblem
    used: Array
    minima: list[Solution[Pose]]

    @property
    def freedom(self) -> int:
        return 2 * len(self.problem.points) - 6


def estimate_poses(
    camera: Camera, views: Sequence[Correspondences], noise_px: float | None = None, loss: Loss | None = None
) -> list[Outcome[Correspondences, PoseEstimate]]:
    """Return camera_T_object of every view, or the InsufficientData that kept it from one, in the views' order.

    noise_px: standard deviation of a pixel coordinate, the factor's root where covariances are given; None estimates
    it from the residuals of all views together. loss: of whitened residuals, in their unit.
    """
    if noise_px is not None and not (np.isfinite(noise_px) and noise_px > 0):
        raise InvalidInput(f"a noise of {noise_px:g} px is not positive")
    fits = [_attempt(camera, view, loss) for view in views]
    sigma, freedom = _noise([fit for fit in fits if isinstance(fit, _Fit)]) if noise_px is None else (noise_px, None)
    return [
        Outcome(view, error=fit) if isinstance(fit, CamcalError) else Outcome(view, _estimate(fit, sigma, freedom))
        for view, fit in zip(views, fits, strict=True)
    ]


def _attempt(camera: Camera, view: Correspondences, loss: Loss | None) -> "_Fit | InsufficientData":
    try:
        return _fit(camera, view, loss)
    except InsufficientData as error:
        return error


def _noise(fits: Sequence[_Fit]) -> tuple[float, int]:
    """Return the standard deviation of a whitened pixel coordinate over all views, and its degrees of freedom."""
    squares = sum(float(fit.problem.squared(fit.minima[0].state).sum()) for fit in fits)
    freedom = sum(fit.freedom for fit in fits)
    return max(float(np.sqrt(squares / max(freedom, 1))), ROUNDING), freedom


def _estimate(fit: _Fit, sigma: float, freedom: int | None) -> PoseEstimate:
    best, *others = fit.minima
    residuals = np.full((len(fit.used), 2), np.nan)
    residuals[fit.used] = fit.problem.residuals(best.state)
    return PoseEstimate(
        CAMERA_T_OBJECT,
        best.state,
        sigma**2 * best.factors().shared_covariance(),
        residuals,
        sigma,
        freedom,
        _alternative(best, others[0], sigma) if others else None,
        best.converged,
        best.reason,
    )


def _alternative(best: Solution[Pose], other: Solution[Pose], sigma: float) -> Alternative:
    from scipy.special import expit

    difference = 2 * (other.cost - best.cost) / sigma**2
    return Alternative(other.state, difference, float(expit(-difference / 2)))


def _fit(camera: Camera, view: Correspondences, loss: Loss | None) -> _Fit:
    rays = camera.unproject(view.pixels)
    inside = view.take(rays.valid)
    extent = _require_enough(view, inside)
    whitening = None
    if inside.covariance is not None:
        whitening = np.linalg.cholesky(np.linalg.inv(inside.covariance)).transpose(0, 2, 1)
    problem = PoseProblem(camera, inside.points, inside.pixels, whitening, loss)
    minima = pose_minima(problem, rays.directions[rays.valid], extent)
    if not minima:
        raise InsufficientData(
            "no pose puts all points in front of the lens; are u and v exchanged, or is it another camera's image?",
            where=view.image,
        )
    _require_fixed(view, minima[0])
    return _Fit(view, problem, rays.valid, minima)


def _require_enough(view: Correspondences, inside: Correspondences) -> Extent:
    """Return the extent of the points; raises InsufficientData if they cannot fix a pose."""
    count = len(np.unique(inside.points, axis=0))
    if count < MIN_POINTS:
        outside = len(view.points) - len(inside.points)
        lost = f" ({outside} more outside the lens's domain)" if outside else ""
        raise InsufficientData(
            f"a pose needs {MIN_POINTS} different points or more, found {count}{lost}", where=view.image
        )
    extent = Extent.of(inside.points)
    if extent.spread[1] < _COLLINEAR * extent.spread[0]:
        raise InsufficientData(
            f"all {count} points lie on one line, about which the object may turn; add a point beside it",
            where=view.image,
        )
    return extent


def _require_fixed(view: Correspondences, solution: Solution[Pose]) -> None:
    """Raise InsufficientData if the points leave a part of the pose open."""
    normal = solution.equations.shared_shared
    scale = np.sqrt(np.diag(normal))
    smallest = np.linalg.eigvalsh(normal / np.outer(scale, scale))[0] if scale.all() else 0.0
    if smallest < _SINGULAR:
        raise InsufficientData(
            f"the points do not fix the pose (condition {1 / max(smallest, 1e-16):.0e}); add points, spread out",
            where=view.image,
        )
