"""Input and output records of pose estimation."""

from typing import Literal

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray, IntArray, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose, carried, inverse_jacobian
from camcal.records import Brief

CAMERA_T_OBJECT, RIG_T_OBJECT = "camera_T_object", "rig_T_object"
AMBIGUOUS = 0.01  # leaves 0.04 % wrong poses among small, far tags
WEAK_TURN, WEAK_PLACE = 0.1, 0.1  # standard deviations: rad, and share of the distance
LARGEST_PX = 1e9  # of a noise; its inverse is the least: numbers beyond cannot be computed with
WEAK_CHANCE, WEAK_MISFIT = 1e-3, 3.0  # poses; times the noise
_PARTS = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, eq=False)
class Correspondences(Brief):
    """Points (N, 3) of an object and the pixels (N, 2) at which one image shows them.

    covariance: (N, 2, 2) px² of the pixels, None for equal ones, of 1 px². camera: its name in a rig.
    object: the name of the object where an image shows several. time: s, None where unknown.
    Raises InvalidInput unless every number is finite and every covariance positive.
    """

    image: str
    points: FloatArray
    pixels: FloatArray
    covariance: FloatArray | None = None
    camera: str | None = None
    object: str = ""
    time: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", readonly(self.points, (None, 3), "points"))
        object.__setattr__(self, "pixels", readonly(self.pixels, (len(self.points), 2), "pixels"))
        if not (np.isfinite(self.points).all() and np.isfinite(self.pixels).all()):
            raise InvalidInput("a point or pixel is not a finite number", where=self.image)
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (len(self.points), 2, 2), "covariance"))
            if not np.all(np.linalg.eigvalsh(self.covariance) > 0):
                raise InvalidInput("the covariance of a pixel is not positive", where=self.image)

    @property
    def ids(self) -> IntArray:
        """The numbers (N,) of the points, in their order."""
        return np.arange(len(self.points))

    @property
    def body(self) -> str:
        """The name of the object."""
        return self.object

    def take(self, chosen: Array) -> "Correspondences":
        """Return some of the points."""
        covariance = None if self.covariance is None else self.covariance[chosen]
        return replace(self, points=self.points[chosen], pixels=self.pixels[chosen], covariance=covariance)

    def alike(self) -> "Correspondences":
        """Return the same with pixels that are all known equally well."""
        return self if self.covariance is None else replace(self, covariance=None)


@dataclass(frozen=True, eq=False)
class PosePrior(Brief):
    """What is known of the pose beforehand: a pose and the covariance (6, 6) of its steps, order tx ty tz rx ry rz."""

    pose: Pose
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", readonly(self.covariance, (6, 6), "the prior's covariance"))
        if not (np.isfinite(self.covariance).all() and np.linalg.eigvalsh(self.covariance)[0] > 0):
            raise InvalidInput("the prior's covariance is not positive")


@dataclass(frozen=True)
class PoseOptions(Brief):
    """How poses are estimated.

    noise_px: standard deviation of every pixel coordinate, in place of the covariances that pixels come with.
    noise_scale: factor on the standard deviations that these covariances give. Without either, the scale is estimated
    from the residuals of all views together.
    outliers: "none"; "few", left out by the residuals of a fit to all points, for boards and tags, samples helping
    where fewer than half would remain; "many", told apart by random samples, at first as if the scale were 1 unless it
    is given.
    threshold_px: the largest residual of an inlier; None: what 99.73 % of all pixels keep to, 3.44 times the noise.
    confidence: that of a better pose, one of the samples had no outlier; seed: of the samples, the same for every view.
    intrinsics: whether the covariance of the lens, and of a rig's transforms, is propagated.
    prior: what is known of the poses of all views; needs the noise, and three points then are enough.
    """

    noise_px: float | None = None
    noise_scale: float | None = None
    outliers: Literal["none", "few", "many"] = "none"
    threshold_px: float | None = None
    confidence: float = 0.999
    seed: int = 0
    intrinsics: bool = True
    prior: PosePrior | None = None

    def __post_init__(self) -> None:
        numbers = (
            ("noise", self.noise_px, " px"),
            ("noise scale", self.noise_scale, ""),
            ("threshold", self.threshold_px, " px"),
        )
        for what, value, unit in numbers:
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InvalidInput(f"a {what} of {value:g}{unit} is not positive")
            if value is not None and not 1 / LARGEST_PX <= value <= LARGEST_PX:
                raise InvalidInput(f"a {what} of {value:g}{unit} is implausible; 0.1 to 1{unit} is usual")
        if self.noise_px is not None and self.noise_scale is not None:
            raise InvalidInput("a noise in px takes the place of what is known of single pixels: give no scale with it")
        if self.outliers not in ("none", "few", "many"):
            raise InvalidInput(f"outliers {self.outliers!r} is not one of none, few, many")
        if not 0 < self.confidence < 1:
            raise InvalidInput(f"a confidence of {self.confidence:g} is not between 0 and 1")
        if self.prior is not None and self.scale is None:
            raise InvalidInput("a prior is weighed against the pixels: give the noise of a pixel coordinate with it")

    @property
    def scale(self) -> float | None:
        """The standard deviation of a pixel coordinate relative to its covariance, None if it is to be estimated."""
        return self.noise_scale if self.noise_px is None else self.noise_px


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another minimum: its pose, how much larger its χ² is, and the probability that it is the true one.

    covariance, noise_covariance: as in PoseEstimate; None where not computed.
    """

    transform: Pose
    chi_square_difference: float
    probability: float
    covariance: FloatArray | None = None
    noise_covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("covariance", "noise_covariance"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name), (6, 6), name))

    def inverse(self) -> "Alternative":
        """Return the same of the transform in the other direction."""
        jacobian = inverse_jacobian(self.transform)
        return replace(
            self,
            transform=self.transform.inverse(),
            covariance=carried(jacobian, self.covariance),
            noise_covariance=carried(jacobian, self.noise_covariance),
        )


@dataclass(frozen=True, eq=False)
class PoseEstimate(Brief):
    """The pose of one view and what is known of its quality.

    frames: what `transform` maps, camera_T_object, rig_T_object or their inverses. covariance: (6, 6) of its steps,
    order tx ty tz rx ry rz (points' unit, rad), R ← Exp(δr) R, t ← t + δt; noise_covariance: the pixels' part of it,
    which differs from view to view; the rest, of the lens, is common to all.
    residuals: (N, 2) px, projected minus observed, NaN for points outside the lens's domain, which are left out.
    inliers: (N,) bool, the points that the pose was fitted to. sigma_px: standard deviation of their coordinates (root
    mean square); noise_scale: that over what the pixels' covariances say, over 1 px where there are none;
    degrees_of_freedom: of its estimate, None if it was given.
    alternatives: other minima, the likeliest first. reason: why the solver stopped.
    planarity: third spread of the points over their first, 0 for a plane. least_depth: smallest z of a point in the
    camera's frame. tilt_rad: angle between the line of sight and the normal of the points' plane, None if they are in
    no plane. condition: of the normal matrix, scaled to a unit diagonal. chance: how many poses with as many inliers
    are expected if no pixel belongs to its point; 0 where outliers were not searched for. misfit: the residuals of the
    inliers over what the noise explains, 1 on average.
    """

    frames: str
    transform: Pose
    covariance: FloatArray
    noise_covariance: FloatArray
    residuals: FloatArray
    inliers: BoolArray
    sigma_px: float
    noise_scale: float
    degrees_of_freedom: int | None
    alternatives: tuple[Alternative, ...]
    converged: bool
    reason: str
    planarity: float = float("nan")
    least_depth: float = float("nan")
    tilt_rad: float | None = None
    condition: float = float("nan")
    chance: float = 0.0
    misfit: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", readonly(self.covariance, (6, 6), "covariance"))
        object.__setattr__(self, "noise_covariance", readonly(self.noise_covariance, (6, 6), "noise covariance"))
        object.__setattr__(self, "residuals", readonly(self.residuals, (None, 2), "residuals"))
        object.__setattr__(self, "inliers", readonly(self.inliers, (len(self.residuals),), "inliers", np.bool_))

    @property
    def used(self) -> int:
        """The number of points that count."""
        return int(np.count_nonzero(self.inliers))

    @property
    def rms_px(self) -> float:
        """The root mean square of the distances between projected and observed pixels of the inliers."""
        return float(np.sqrt(np.sum(self.residuals[self.inliers] ** 2) / self.used)) if self.used else float("nan")

    @property
    def alternative(self) -> Alternative | None:
        """The likeliest of the other minima."""
        return self.alternatives[0] if self.alternatives else None

    @property
    def p_wrong(self) -> float:
        """The probability that one of the alternatives is the true pose; 0 without any."""
        return float(sum(other.probability for other in self.alternatives))

    @property
    def status(self) -> str:
        """Whether the pose is to be trusted, in words that begin with ok, ambiguous, weak or not converged."""
        if not self.converged:
            return f"not converged: {self.reason}"
        if self.p_wrong > AMBIGUOUS:
            return f"ambiguous: another pose has nearly the same residuals, probability {self.p_wrong:.2g}"
        weakness = self._weakness()
        return f"weak: {weakness}" if weakness else "ok"

    def _weakness(self) -> str | None:
        if self.chance > WEAK_CHANCE:
            return f"{self.used} of {len(self.inliers)} inliers; expected by chance: {self.chance:.1g} such poses"
        if self.misfit > WEAK_MISFIT:
            return f"residuals are {self.misfit:.2g} x the noise of {self.sigma_px:.2g} px"
        place, turn = (np.sqrt(np.linalg.eigvalsh(self.covariance[part, part])[-1]) for part in _PARTS)
        distance = np.linalg.norm(self.transform.translation)
        if turn > WEAK_TURN:
            return f"standard deviation of the rotation {np.degrees(turn):.2g}° only (1 σ)"
        if place > WEAK_PLACE * distance:
            return f"standard deviation of the translation {100 * place / distance:.2g} % of the distance only (1 σ)"
        return None

    def inverse(self) -> "PoseEstimate":
        """Return the same estimate of the transform in the other direction."""
        jacobian = inverse_jacobian(self.transform)
        return replace(
            self,
            frames="_T_".join(reversed(self.frames.split("_T_"))),
            transform=self.transform.inverse(),
            covariance=jacobian @ self.covariance @ jacobian.T,
            noise_covariance=jacobian @ self.noise_covariance @ jacobian.T,
            alternatives=tuple(other.inverse() for other in self.alternatives),
        )
