"""The nearest camera of another lens model: the same lens where that is exact, or fitted, and how far off it is.

A fit is over the valid part of the image. Exact: a sphere is a plane's pinhole, one of two, or an ellipsoid. With f the
pixels per radian on the axis, ucm is eucm with β = 1, double_sphere with ξ = 0, and mei with ξ = α / (1 - α) without
distortion, f (1 + ξ); double_sphere with α = 0 is that as well. Any of them is a pinhole where nothing makes it
another lens.
Source: Geyer & Daniilidis, ECCV 2000; Usenko, Demmel & Cremers, 3DV 2018, section 2.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import MODELS
from camcal.cameras.directions import grid_pixels, projection_covariances
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera, require_central
from camcal.cameras.spline import CUBIC, SplinedStereographic
from camcal.cameras.spline_modes import reduced_spline
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.solve.dense import DenseMethod, minimise_dense
from camcal.solve.least_squares import minimise
from camcal.solve.steps import Block, Jacobian, Step

_FITTED, _CHECKED = 31, 101  # rays a side of the image
_BESIDE = 0.5  # px from the edges of the image that still belong to it
_SMALL = 1e-4  # rad from the axis, where the focal lengths are taken
_PARTS = (0.3, 0.6, 1.0)  # of the largest angle from the axis: a lens is fitted from its middle outwards
_KNOTS, _MARGIN = 24, 1.02  # of a spline: across the longer side, and how far beyond the outermost ray
_CLOSER, _ROUNDS = 12, 2  # the farthest place is looked for between the rays in so many steps, so many times

_FOUR = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
Values = Mapping[str, float]
Steps = dict[str, tuple[tuple[str, bool, Values], ...]]


@dataclass(frozen=True, eq=False)
class Refit:
    """A camera of another model and how far its pixels are from those of the first, px: RMS and largest.

    max_theta: the angle from the axis, rad, up to which the two are compared, as far as the image and its circle reach.
    Where one of the two has no ray for a pixel within it, the largest is infinite. jacobian: (L, K) of its parameters
    by those of the first.
    """

    camera: Camera
    rms_px: float
    max_px: float
    max_theta: float
    jacobian: Array


@dataclass(frozen=True, eq=False)
class Region:
    """Where in an image a lens is fitted: within its image circle, and up to an angle (rad) from the axis."""

    circle: ImageCircle | None = None
    max_theta: float = math.inf


_WHOLE = Region()


def refit(camera: Camera, model: CameraModel, region: Region = _WHOLE) -> Refit:
    """Return the camera of `model` whose pixels come nearest to those of `camera` for rays through its image.

    The axes stay: focal lengths, principal point and distortion are fitted, no rotation. Where the camera has a
    covariance, places count by their standard deviation, and the camera found has the covariance that follows.
    Raises InsufficientData if the camera has too few rays, or the model no lens near it.
    """
    for either in (camera.model, model):
        require_central(either)
    rays, pixels = _samples(camera, _FITTED, region)
    if 2 * len(rays) < len(model.parameter_names):
        raise InsufficientData(f"the lens has a ray for {len(rays)} of {_FITTED**2} pixels; none can be fitted to it")
    weights = _weights(camera, pixels)
    if isinstance(model, SplinedStereographic):
        spline = reduced_spline(camera, rays, weights, _covering(model, rays))
        own = Camera(spline.spline, camera.image_size, spline.knots_of(spline.start_values))
        jacobian = spline.basis[:, : len(camera.parameters)]
        return _compare(camera, _with_covariance(own, camera, jacobian), jacobian, region)
    found = min(_fits(camera, model, rays, pixels, weights), key=lambda fit: fit[0], default=None)
    if found is None:
        raise InsufficientData(f"{model.name} has no place for the rays of this lens")
    jacobian = _sensitivity(camera, model, found[1], rays, weights)
    own = Camera(model, camera.image_size, found[1])
    return _compare(camera, _with_covariance(own, camera, jacobian), jacobian, region)


def _with_covariance(fitted: Camera, camera: Camera, jacobian: Array) -> Camera:
    """Return a fitted camera with the covariance that follows from that of a camera."""
    if camera.covariance is None:
        return fitted
    return replace(fitted, covariance=jacobian @ camera.covariance @ jacobian.T)


def _covering(model: SplinedStereographic, rays: Array) -> SplinedStereographic:
    """Return a spline with knots over all rays (M, 3), the model itself where its knots are not the usual ones."""
    if model != SplinedStereographic():
        return model
    reach = _MARGIN * np.abs(2 * rays[:, :2] / (1 + rays[:, 2:])).max(axis=0)
    per_unit = (_KNOTS - CUBIC) / (2 * reach.max())
    columns, rows = (int(np.ceil(2 * own * per_unit)) + CUBIC for own in reach)
    fov = float(np.ceil(np.degrees(4 * np.arctan(reach[0] / 2))))
    return SplinedStereographic(knots=(columns, rows), fov_x_deg=fov)


def fit_lens(model: CameraModel, rays: Array, pixels: Array, start: Array) -> Array | None:
    """Return the parameters (K,) of a lens whose pixels come nearest to those (N, 2) of rays (N, 3), None where the
    lens has no image of one of them at the start (K,).
    """
    problem = _Refit(model, rays, pixels)
    return None if problem.blocks(start) is None else minimise(problem, start).state


def _fits(
    camera: Camera, model: CameraModel, rays: Array, pixels: Array, weights: Array
) -> Iterator[tuple[float, Array]]:
    """Yield costs and parameters (L,): from the parameters of the same names, and from the middle of the lens."""
    values = dict(zip(camera.model.parameter_names, camera.parameters.tolist(), strict=True))
    alike = np.array([values.get(name, own) for name, own in zip(model.parameter_names, model.prior_mean, strict=True)])
    angles = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    for start, parts in ((alike, _PARTS[-1:]), (_start(camera, model), _PARTS)):
        state = start
        for part in parts:
            within = angles <= part * angles.max()
            problem = _Refit(model, rays[within], pixels[within], weights[within])
            if problem.blocks(state) is None or 2 * within.sum() < problem.shared:
                continue
            solution = minimise_dense(problem, state, DenseMethod())
            state = solution.state
            if part == _PARTS[-1]:
                yield solution.equations.cost, state


def _start(camera: Camera, model: CameraModel) -> Array:
    """Return parameters (L,) of a lens without distortion that has the focal lengths and the axis of a camera."""
    around = _SMALL * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    pixels = camera.project(np.column_stack([around, np.ones(4)])).pixels
    focal = np.array([pixels[0, 0] - pixels[1, 0], pixels[2, 1] - pixels[3, 1]]) / (2 * _SMALL)
    start = model.start(camera.image_size, 1.0)
    start[:2] *= focal
    start[2:4] = pixels.mean(axis=0)
    return start


def _weights(camera: Camera, pixels: Array) -> Array:
    """Return what pixels (N, 2) count: the inverses of their variances with a typical one added, 1 at most."""
    if camera.covariance is None:
        return np.ones(len(pixels))
    variances = np.trace(projection_covariances(camera, pixels), axis1=1, axis2=2)
    typical = np.nanmedian(variances)
    if not typical > 0:
        return np.ones(len(pixels))
    return np.asarray(typical / (np.where(np.isfinite(variances), variances, np.inf) + typical))


def _sensitivity(camera: Camera, model: CameraModel, state: Array, rays: Array, weights: Array) -> Array:
    """Return the derivatives (L, K) of the parameters of the nearest lens by those of the camera."""
    own = camera.project_with_jacobians(rays)
    other = model.project_with_jacobians(state, rays, within_domain=False)
    there = own.valid & other.valid
    scale = np.sqrt(weights[there, None, None])
    by_own = (scale * own.by_parameters(len(camera.parameters))[there]).reshape(-1, len(camera.parameters))
    by_other = (scale * other.by_parameters(len(state))[there]).reshape(-1, len(state))
    lengths = np.linalg.norm(by_other, axis=0)
    lengths[lengths == 0] = 1.0
    return np.asarray(np.linalg.lstsq(by_other / lengths, by_own, rcond=None)[0] / lengths[:, None])


def _compare(camera: Camera, fitted: Camera, jacobian: Array, region: Region) -> Refit:
    """Return a fitted camera with its differences on rays that it was not fitted to."""
    rays, pixels = _samples(camera, _CHECKED, region)
    apart = _distances(fitted, rays, pixels)
    there = apart[np.isfinite(apart)]
    theta = float(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]).max(initial=0.0))
    if not len(there):
        return Refit(fitted, np.inf, np.inf, theta, jacobian)
    whole = len(there) == (_CHECKED**2 if region == _WHOLE else len(rays))
    largest = _largest(camera, fitted, pixels[np.nanargmax(apart)], region) if whole else np.inf
    return Refit(fitted, float(np.sqrt(np.mean(there**2))), max(largest, float(there.max())), theta, jacobian)


def _largest(camera: Camera, fitted: Camera, place: Array, region: Region) -> float:
    """Return the largest difference, px, around the place (2,) that has the largest of those compared."""
    reach = (np.array(camera.image_size) - 1 + 2 * _BESIDE) / (_CHECKED - 1)
    largest = 0.0
    for _ in range(_ROUNDS):
        axes = (np.linspace(at - step, at + step, _CLOSER) for at, step in zip(place, reach, strict=True))
        pixels = np.clip(grid_pixels(*axes), -_BESIDE, np.array(camera.image_size) - 1 + _BESIDE)
        rays, pixels = _inside(camera, pixels, region)
        apart = _distances(fitted, rays, pixels)
        if not np.isfinite(apart).any():
            break
        place, largest = pixels[np.nanargmax(apart)], max(largest, float(np.nanmax(apart)))
        reach = reach / _CLOSER
    return largest


def _distances(fitted: Camera, rays: Array, pixels: Array) -> Array:
    """Return how far (N,) the pixels of rays (N, 3) are from pixels (N, 2), NaN for rays that have none."""
    return np.asarray(np.linalg.norm(fitted.project(rays).pixels - pixels, axis=1))


def _samples(camera: Camera, side: int, region: Region) -> tuple[Array, Array]:
    """Return rays (N, 3) through a grid over the image, as far as the lens has them, and their pixels (N, 2)."""
    axes = (np.linspace(-_BESIDE, length - 1 + _BESIDE, side) for length in camera.image_size)
    return _inside(camera, grid_pixels(*axes), region)


def _inside(camera: Camera, pixels: Array, region: Region) -> tuple[Array, Array]:
    """Return the rays (N, 3) of those pixels (M, 2) that have one within the region, and these (N, 2)."""
    rays = camera.unproject(pixels)
    known = rays.valid
    if region.circle is not None:
        known = known & region.circle.contains(pixels)
    directions = rays.directions
    with np.errstate(invalid="ignore"):
        known = known & (np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2]) <= region.max_theta)
    return np.asarray(directions[known]), pixels[known]


@dataclass(frozen=True, eq=False)
class _Refit:
    """Residuals of the pixels (N, 2) that rays (N, 3) have in a lens model, by its parameters; weights: (N,)."""

    model: CameraModel
    rays: Array
    pixels: Array
    weights: Array | None = None

    @property
    def shared(self) -> int:
        return len(self.model.parameter_names)

    @property
    def groups(self) -> tuple[int, int]:
        return 0, 0

    def blocks(self, state: Array) -> Sequence[Block] | None:
        projection = self.model.project_with_jacobians(state, self.rays, within_domain=False)
        if not projection.valid.all():
            return None
        every = np.arange(self.shared)
        columns = every if projection.columns is None else projection.columns
        jacobian = Jacobian(projection.d_parameters, columns)
        return [Block(projection.pixels - self.pixels, (jacobian,), weights=self.weights)]

    def retract(self, state: Array, step: Step) -> Array:
        return np.asarray(state + step.shared)


def same_lens(camera: Camera) -> tuple[Camera, ...]:
    """Return a camera, first as it is, and in every other lens model that is exactly the same, without covariances."""
    found = {camera.model.name: camera}
    waiting = [camera]
    while waiting:
        own = waiting.pop(0)
        values = dict(zip(own.model.parameter_names, own.parameters.tolist(), strict=True))
        for name, other in _steps(own, values):
            if name not in found:
                model = MODELS[name]
                parameters = [other.get(each, 0.0) for each in model.parameter_names]
                found[name] = Camera(model, own.image_size, np.array(parameters))
                waiting.append(found[name])
    return tuple(found.values())


def _steps(camera: Camera, values: Values) -> Iterator[tuple[str, Values]]:
    """Yield the models that a camera, with these parameters by name, is one exact step from, and their parameters."""
    core = {name: values[name] for name in ("fx", "fy", "cx", "cy")}
    alpha, xi = values.get("alpha", 0.0), values.get("xi", 0.0)
    bare = not any(values.get(name) for name in ("k1", "k2", "p1", "p2"))
    ratio = alpha / (1.0 - alpha) if alpha < 1 else np.inf
    steps: Steps = {
        "pinhole": (("ucm", True, core), ("mei", True, core), ("division", True, core)),
        "ucm": (
            ("eucm", True, {**values, "beta": 1.0}),
            ("double_sphere", True, values),
            ("mei", alpha < 1, {**_stretched(core, 1.0 + ratio), "xi": ratio}),
        ),
        "eucm": (("ucm", values.get("beta") == 1, values),),
        "double_sphere": (("ucm", xi == 0, values), ("mei", alpha == 0 and xi > 0, values)),
        "mei": (
            ("opencv4", xi == 0, values),
            ("ucm", bare, {**_stretched(core, 1.0 / (1.0 + xi)), "alpha": xi / (1.0 + xi)}),
            ("double_sphere", bare and xi <= 1, values),
        ),
    }
    steps |= _fisheye_steps(values)
    if camera.model.is_pinhole(camera.parameters):
        yield "pinhole", core
    yield from ((other, found) for other, holds, found in steps.get(camera.model.name, ()) if holds)


def _fisheye_steps(values: Values) -> Steps:
    """Return the steps between fisheyes with a polynomial, whose coefficients have other names in fisheye624."""
    four, p1, p2 = {name: values.get(name, 0.0) for name in _FOUR}, values.get("p1", 0.0), values.get("p2", 0.0)
    zero = {name for name, value in values.items() if value == 0}
    further = values.keys() - zero - four.keys()
    aria = {f"k{index}": values.get(f"k{index + 1}", 0.0) for index in range(5)}
    back = {f"k{index + 1}": values.get(f"k{index}", 0.0) for index in range(5)}
    return {
        "kannala_brandt4": (
            ("fisheye62", True, four),
            ("thin_prism_fisheye", True, four),
            ("kannala_brandt5t", True, four),
        ),
        "kannala_brandt5t": (
            ("kannala_brandt4", not further, four),
            ("fisheye624", True, {**four, **aria, "p0": p2, "p1": p1}),
            ("fisheye62", not further - {"k5"}, values),
        ),
        "fisheye62": (("kannala_brandt5t", not further - {"k5"}, values), ("opensfm_fisheye624", True, values)),
        "opensfm_fisheye624": (("fisheye62", not further - {"k5", "k6", "p1", "p2"}, values),),
        "thin_prism_fisheye": (("kannala_brandt4", not further, four),),
        "fisheye624": (
            (
                "kannala_brandt5t",
                not further - {"k0", "p0", "p1"} and not values.get("k5"),
                {**four, **back, "p1": p1, "p2": values.get("p0", 0.0)},
            ),
        ),
    }


def _stretched(core: Values, scale: float) -> Values:
    return {**core, "fx": core["fx"] * scale, "fy": core["fy"] * scale}
