"""Lateral chromatic aberration: a separate lens for a colour, relative to the calibrated one.

A lens images red and blue a little larger or smaller than green. Green has given the poses, the shape of the board
and a lens; these poses and that shape are held, and what the corners in another colour leave over is put down to its
lens alone. With n the noise of the corners, H the projection on the column space of green's Jacobian and J the lens's
columns of it, the lenses differ by (JᵀJ)⁻¹ Jᵀ (n_colour - H n_green). As the columns of J lie in that space, H drops
out: what green got wrong about poses and board is the same for all colours and cancels, and
    cov(colour - green) = (σ²_colour + σ²_green) (JᵀJ)⁻¹,   cov(colour) = cov(green) + (σ²_colour - σ²_green) (JᵀJ)⁻¹.
Lenses of one glass differ by little more than a scale. Colours take over from green what the corners do not tell apart:
a coefficient of the sixth power, fitted to noise, would say nothing true of the corners of the image.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.noise import CUT, robust_sigma, truncation
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.cameras.observations import linearised, residuals
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, NotConverged
from camcal.solve.least_squares import Solution, minimise
from camcal.solve.losses import Cauchy, Loss, chi_square_beyond
from camcal.solve.steps import Block, Jacobian, SingularError, Step
from camcal.targets.detection import BoardDetection

_CORNERS_A_PARAMETER = 5
_LOSS = Cauchy(3.0)
_ROUGH_ROUNDS, _ROUNDS = 2, 8
_SIGNIFICANCE = 1e-3  # as of the tiers of a board's shape
_LATTICE = (33, 25)  # places where the aberration is examined, the corners of the image among them


@dataclass(frozen=True, eq=False)
class ColourLens:
    """The lens of one colour.

    camera: with the covariance of its own parameters. terms: the parameters that differ from the main camera's.
    difference_covariance: (K, K) of its parameters less those of the main camera, far smaller. sigma_px: the noise of
    one coordinate of its corners. points: corners kept of those that were measured, rejected: the others.
    """

    camera: Camera
    terms: tuple[str, ...]
    difference_covariance: FloatArray
    sigma_px: float
    points: int
    rejected: int


@dataclass(frozen=True, eq=False)
class Aberration:
    """How far one colour lies from another in the image, pixels.

    corner_px: outwards along the radius at the place of the image furthest from the principal point. largest_px: the
    largest distance anywhere, at pixel largest_at (2,). The standard deviations belong to the same places.
    """

    corner_px: float
    corner_std_px: float
    largest_px: float
    largest_std_px: float
    largest_at: FloatArray


def fit_colour(calibration: Calibration, views: Sequence[BoardDetection], colour: str) -> ColourLens:
    """Return the lens of a colour in which the views of a calibration were measured again.

    views: one for each of calibration.views, numbered as their detections were; of their colours, views and corners may
    be missing.
    Raises InsufficientData for too few corners, NotConverged.
    """
    problem = _LensProblem.of(calibration.camera, *_pairs(calibration, views, colour))
    measured = len(problem.pixels)
    problem, solution = _simplest(*_settled(problem), calibration.sigma_px)
    if not solution.converged:
        raise NotConverged(
            f"the lens of a colour did not converge ({solution.reason}): add views, or leave out --channels"
        )
    kept = problem.weights > 0
    dof = 2 * int(kept.sum()) - problem.shared
    sigma = float(np.sqrt(np.sum(problem.distances(solution.state)[kept] ** 2) / dof / truncation()))
    inverse = problem.inverse(solution)
    covariance = calibration.camera.covariance
    if covariance is not None:  # fewer corners than green has would otherwise seem to know more than green
        covariance = covariance + max(sigma**2 - calibration.sigma_px**2, 0.0) * inverse
    return ColourLens(
        replace(calibration.camera, parameters=solution.state, covariance=covariance),
        tuple(calibration.camera.model.parameter_names[index] for index in problem.free),
        readonly((sigma**2 + calibration.sigma_px**2) * inverse, inverse.shape, "covariance"),
        sigma,
        int(kept.sum()),
        measured - int(kept.sum()),
    )


def aberration(main: Camera, lens: ColourLens) -> Aberration:
    """Return how far the image of a colour lies from that of the main camera, over the part of it both lenses show."""
    axes = [np.linspace(0, side - 1, count) for side, count in zip(main.image_size, _LATTICE, strict=True)]
    pixels = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    rays = main.unproject(pixels)
    seen = lens.camera.model.project_with_jacobians(lens.camera.parameters, rays.at())
    both = rays.valid & seen.valid
    pixels, moved, by_lens = (
        pixels[both],
        seen.pixels[both] - pixels[both],
        seen.by_parameters(len(lens.difference_covariance))[both],
    )
    outwards = pixels - [main.value("cx"), main.value("cy")]
    radius, distance = np.linalg.norm(outwards, axis=1), np.linalg.norm(moved, axis=1)
    corner, largest = int(np.argmax(radius)), int(np.argmax(distance))

    def deviation(place: int, direction: Array) -> float:
        slope = direction @ by_lens[place]
        return float(np.sqrt(max(slope @ lens.difference_covariance @ slope, 0.0)))

    along, way = outwards[corner] / radius[corner], moved[largest] / max(distance[largest], 1e-12)
    return Aberration(
        float(moved[corner] @ along),
        deviation(corner, along),
        float(distance[largest]),
        deviation(largest, way),
        readonly(pixels[largest], (2,), "pixel"),
    )


def _pairs(calibration: Calibration, views: Sequence[BoardDetection], colour: str) -> tuple[Array, Array]:
    """Return points (N, 3) in the camera frame as the calibration has them, and pixels (N, 2) of the colour.

    Corners that were rejected in the calibration stay out.
    """
    rejected = {(corner.image, corner.id) for corner in calibration.rejected}
    board_points = calibration.surface.points()
    points, pixels = [np.zeros((0, 3))], [np.zeros((0, 2))]
    for record, view in zip(calibration.views, views, strict=True):
        own = view.colours.get(colour)
        if record.camera_T_board is None or own is None or not own.found:
            continue
        ids = calibration.board.symmetries()[record.symmetry][own.ids]
        kept = np.array([(view.image, int(index)) not in rejected for index in ids])
        points.append(record.camera_T_board.apply(board_points[ids[kept]]))
        pixels.append(own.pixels[kept])
    return np.concatenate(points), np.concatenate(pixels)


@dataclass(frozen=True, eq=False)
class _LensProblem:
    """The residuals of pixels (N, 2) of points (N, 3) known in the camera frame; the free lens parameters alone move.

    start: (K,) parameters that weak priors of width spread (K,) hold. weights: (N,), 0 for outliers.
    """

    model: CameraModel
    points: Array
    pixels: Array
    free: Array
    start: Array
    spread: Array
    weights: Array
    sigma: float = 1.0
    loss: Loss | None = None

    @classmethod
    def of(cls, camera: Camera, points: Array, pixels: Array) -> "_LensProblem":
        """Return the problem that starts at a camera; raises InsufficientData if it sees too few of the points."""
        seen = camera.project(points).valid if len(points) else np.zeros(0, np.bool_)
        names = camera.model.parameter_names
        free = np.array([index for index, name in enumerate(names) if name not in camera.fixed], np.intp)
        spread = camera.model.prior_std(camera.image_size, camera.value("fx"))
        weights = np.ones(int(seen.sum()))
        problem = cls(
            camera.model, points[seen], pixels[seen], free=free, start=camera.parameters, spread=spread, weights=weights
        )
        needed = _CORNERS_A_PARAMETER * len(free)
        if len(weights) < needed:
            raise InsufficientData(
                f"only {len(weights)} corners of a colour are clear; {needed} at least are needed: add sharp views, or "
                "leave out --channels"
            )
        return problem

    @property
    def shared(self) -> int:
        return len(self.free)

    @property
    def groups(self) -> tuple[int, int]:
        return 0, 0

    def distances(self, parameters: Array) -> Array:
        """Return the lengths (N,) of the residuals, NaN outside the lens's domain."""
        return np.asarray(np.hypot(*residuals(self.model, parameters, self.points.T, self.pixels.T)))

    def screened(self, parameters: Array, loss: Loss | None = None) -> "_LensProblem":
        """Return the problem with σ brought up to date, and without a loss with outliers at weight 0."""
        distances = self.distances(parameters)
        everything = np.ones(len(distances), np.bool_)
        sigma = robust_sigma(distances, everything, 1 - self.shared / (2 * len(distances)))
        kept = everything if loss else distances <= CUT * sigma
        return replace(self, weights=kept.astype(float), sigma=sigma, loss=loss)

    def blocks(self, parameters: Array) -> list[Block] | None:
        seen = linearised(self.model, parameters, self.points.T, self.pixels.T, within_domain=False)
        if np.any(self.weights[~seen.valid] > 0):
            return None
        by_lens = Jacobian(seen.by_lens[:, self.free].transpose(2, 0, 1), np.arange(self.shared))
        data = Block(seen.residuals.T, (by_lens,), weights=self.weights / self.sigma**2, loss=self.loss)
        slopes = 1 / self.spread[self.free]
        pull = (parameters - self.start)[self.free] * slopes
        return [data, Block(pull[:, None], (Jacobian(slopes[:, None, None], np.arange(self.shared)[:, None]),))]

    def retract(self, parameters: Array, step: Step) -> Array:
        moved = parameters.copy()
        moved[self.free] += step.shared
        return moved

    def inverse(self, solution: Solution[Array]) -> Array:
        """Return (JᵀJ)⁻¹ (K, K) of the lens parameters for corners of σ = 1 px, 0 for those that are held."""
        result = np.zeros((len(self.start), len(self.start)))
        try:
            result[np.ix_(self.free, self.free)] = solution.factors().shared_covariance() / self.sigma**2
        except SingularError as error:
            raise InsufficientData(
                "the corners of a colour leave parameters of its lens undetermined: add views with the board in the "
                "corners of the image, or leave out --channels"
            ) from error
        return result


def _settled(problem: _LensProblem) -> tuple[_LensProblem, Solution[Array]]:
    """Return the problem with outliers at weight 0 and its solution: robust at first, then cut at CUT σ."""
    parameters = problem.start
    for _ in range(_ROUGH_ROUNDS):
        parameters = minimise(problem.screened(parameters, _LOSS), parameters).state
    problem = problem.screened(parameters)
    for _ in range(_ROUNDS):
        solution = minimise(problem, parameters)
        parameters = solution.state
        following = problem.screened(parameters)
        if np.array_equal(following.weights, problem.weights):
            return problem, solution
        problem = following
    return problem, minimise(problem, parameters)


def _simplest(problem: _LensProblem, full: Solution[Array], main_sigma: float) -> tuple[_LensProblem, Solution[Array]]:
    """Return the problem of the first stage that explains the corners as well as its full solution, and its own.

    main_sigma: the noise of the main camera's corners. The errors of its lens lie where this lens can follow them, so
    that along its parameters both noises add up.
    """
    names = problem.model.parameter_names
    share = problem.sigma**2 / (problem.sigma**2 + main_sigma**2)
    for stage in problem.model.colour_stages:
        free = np.array([index for index in problem.free if names[index] in stage], np.intp)
        dof = len(problem.free) - len(free)
        if not len(free) or not dof:
            continue
        trial = replace(problem, free=free)
        solution = minimise(trial, problem.start)
        if solution.converged and chi_square_beyond(2 * share * (solution.cost - full.cost), dof) > _SIGNIFICANCE:
            return trial, solution
    return problem, full
