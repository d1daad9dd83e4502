"""Which views a calibration would gain most from, and which it could do without.

A view adds what its corners say of the lens once its own pose is eliminated: the same normal equations that the
calibration solves. Of a grid of poses those are taken, one after the other, after which the variance of projections
over the image is least; each of them is then exchanged for a better one, the others given, if there is one.
Source: Pukelsheim, Optimal Design of Experiments, 1993 (linear criteria); Fedorov, Theory of Optimal Experiments, 1972
(exchanges).
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

from camcal.arrays import Array, BoolArray
from camcal.cameras.directions import GRID, covariance_root, direction_displacements, grid_pixels
from camcal.cameras.model import Camera
from camcal.cameras.observations import Observations
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.forecast import free_parameters, view_information
from camcal.records import Brief
from camcal.targets.board import Board, Surface
from camcal.targets.detection import BoardDetection

_TILTS = tuple(np.radians((25.0, 50.0)))
_AZIMUTHS = tuple(np.radians(np.arange(0.0, 360.0, 45.0)))
_SPINS = (0.0, np.pi / 2)
_ACROSS, _DOWN = (0.05, 0.275, 0.5, 0.725, 0.95), (0.05, 0.5, 0.95)  # of the image; boards are moved into it
_DISTANCES, _MARGIN = 4, 1.15  # how many, and how far beyond the boards that were seen: images are sharp there too
_BORDER = 1.0  # squares around the corners that are in the image as well
_STEEPEST = np.radians(70)  # between the board's normal and a line of sight
_STEPS = 8  # by which boards are moved into the image
_SPARED, _KEPT = 0.02, 10  # what views that are left out may add to the uncertainty, and how many are to be left
_FILLS = (0.85, 0.4)  # of the image's smaller side, by a board whose distances are not known


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of a camera before further views. noise_px: of a coordinate of a corner. surface: the board.

    distances: of the nearest and the farthest board that was seen, in the board's unit, None where they are not known.
    noise_share: of the variance of projections that noise accounts for. circle: of the image, where there is one.
    """

    camera: Camera
    surface: Surface
    noise_px: float
    distances: tuple[float, float] | None = None
    noise_share: float = 1.0
    circle: ImageCircle | None = None


@dataclass(frozen=True, eq=False)
class SuggestedView(Brief):
    """A view that is worth taking. pose: camera_T_board. centre: (2,) px of the middle of the board. distance: of that
    from the camera, in the board's unit. tilt: angle (rad) between its normal and the line of sight. lean: (2,) the
    direction in the image of the side that is nearer, zero without tilt. upright: whether the board is turned by 90°
    from having its x axis along the rows. std_px: of projections over the image after this view and those before it.
    """

    pose: Pose
    centre: tuple[float, float]
    distance: float
    tilt: float
    lean: tuple[float, float]
    upright: bool
    std_px: float


@dataclass(frozen=True, eq=False)
class ViewAdvice(Brief):
    """What further views would do.

    std_px: of projections over the image (RMS, all image directions), as they are known. views: the suggested ones, in
    the order in which to take them. spared: images that may be left out, none where the views are not known, and
    spared_share: by how much the uncertainty is larger without them.
    """

    std_px: float
    views: tuple[SuggestedView, ...]
    spared: tuple[str, ...] = ()
    spared_share: float = 0.0


@dataclass(frozen=True, eq=False)
class Candidates:
    """Poses of a board that an image can have: rotations (V, 3, 3), translations (V, 3), exact pixels (V, P, 2) of its
    corners; leans (V, 2) rad about the image's axes, spins (V,) rad, centres (V, 2) px, distances (V,).
    """

    rotations: Array
    translations: Array
    pixels: Array
    leans: Array
    spins: Array
    centres: Array
    distances: Array

    @property
    def poses(self) -> list[Pose]:
        """The poses camera_T_board."""
        return [Pose(*pair) for pair in zip(self.rotations, self.translations, strict=True)]

    def information(self, known: Known) -> Array:
        """Return what each of them says (V, D, D) of the free lens parameters and the terms of the board."""
        count = known.surface.board.count
        ids, present = np.tile(np.arange(count), (len(self.pixels), 1)), np.ones(self.pixels.shape[:2])
        exact = Observations(ids, np.moveaxis(self.pixels, 2, 0).copy(), present)
        return view_information(known.camera, known.surface, exact, self.poses, known.noise_px)


def advise(known: Known, count: int = 3, seen: Sequence[tuple[BoardDetection, Pose]] = ()) -> ViewAdvice:
    """Return the views to take next, and of those that were `seen`, with camera_T_board, the ones to leave out.

    Raises InsufficientData where no view of the board fits the image, or the lens is not known but by its model.
    """
    found = candidates(known)
    information = known.noise_share * found.information(known)
    root, metric = _prior_root(known), _image_metric(known)
    lens = len(metric)
    metric = root[:lens].T @ metric @ root[:lens]
    gains = root.T @ information @ root
    chosen, stds = choose(gains, metric, count)
    views = [suggest(found, index, std) for index, std in zip(chosen, stds, strict=True)]
    spared, rise = _spared(known, [*seen]) if len(seen) > _KEPT else ((), 0.0)
    return ViewAdvice(float(np.sqrt(np.trace(metric) / 2)), tuple(views), spared, rise)


def telling_view(known: Known, information: Array, axis: Array) -> SuggestedView:
    """Return the view beside others that shows best how a lens has changed along an axis (F,) of its free parameters.

    information: (F, F) of the others. std_px: 0, as nothing is estimated. Raises as `advise`.
    """
    found = candidates(known)
    count = len(axis)
    total = information + found.information(known)[:, :count, :count]
    free = free_parameters(known.camera)
    covariance = np.asarray(known.camera.covariance)[np.ix_(free, free)]
    seen = np.linalg.solve(np.eye(count) + total @ covariance, (total @ axis)[..., None])
    return suggest(found, int(np.argmax(seen[..., 0] @ axis)), 0.0)


def _prior_root(known: Known) -> Array:
    """Return a root (D, D) of the covariance of free lens parameters and terms of the board."""
    free, surface = free_parameters(known.camera), known.surface
    if known.camera.covariance is None or not len(free):
        raise InsufficientData("no covariance of the lens is known, so that nothing can be said of views: calibrate it")
    lens = covariance_root(known.camera.covariance[np.ix_(free, free)])
    result = np.zeros((len(free) + len(surface.terms),) * 2)
    result[: len(free), : len(free)] = lens
    result[len(free) :, len(free) :] = covariance_root(surface.covariance)
    return result


def _image_metric(known: Known) -> Array:
    """Return the metric (F, F) of changes of the free lens parameters: the mean square of what they move, px², over all
    of the image that the lens images, a rotation left out.
    """
    camera = known.camera
    pixels = grid_pixels(*(np.linspace(0, n - 1, count) for n, count in zip(camera.image_size, GRID, strict=True)))
    if known.circle is not None:
        pixels = pixels[known.circle.contains(pixels)]
    moved = direction_displacements(camera, pixels)[:, :, free_parameters(camera)]
    moved = moved[np.isfinite(moved).all(axis=(1, 2))]
    flat = moved.reshape(-1, moved.shape[2])
    return np.asarray(flat.T @ flat / max(len(moved), 1))


def choose(gains: Array, metric: Array, count: int) -> tuple[list[int], list[float]]:
    """Return which candidates to take, and the standard deviations (RMS of two directions) after each; gains: (V, D, D)
    of the information and metric (D, D), both in standard deviations of what is known.
    """
    start = np.eye(len(metric))

    def variances(chosen: Sequence[int]) -> Array:
        """Return the variances (V,), px², after chosen views and each other one."""
        after = np.linalg.inv(start + gains[list(chosen)].sum(axis=0) + gains)
        values = np.einsum("vij,ji->v", after, metric) / 2
        values[list(chosen)] = np.inf  # the same view again would say nothing of errors that repeat with it
        return np.asarray(values)

    chosen: list[int] = []
    for _ in range(min(count, len(gains))):
        chosen.append(int(np.argmin(variances(chosen))))
    for place in range(len(chosen)):
        others = [*chosen[:place], *chosen[place + 1 :]]
        chosen[place] = int(np.argmin(variances(others)))
    order: list[int] = []
    stds: list[float] = []
    while len(order) < len(chosen):
        values = variances(order)
        order.append(min((each for each in chosen if each not in order), key=lambda each: values[each]))
        stds.append(float(np.sqrt(values[order[-1]])))
    return order, stds


def suggest(found: Candidates, index: int, std: float) -> SuggestedView:
    """Return a candidate as a view to take: where the board is and how it is tilted; std: what is left after it."""
    lean, (u, v) = found.leans[index], found.centres[index].tolist()
    tilt = float(np.linalg.norm(lean))
    # a turn by a positive angle about the rows takes the lower edge, y > 0, away from the camera
    nearer = (float(lean[1] / tilt), float(-lean[0] / tilt)) if tilt else (0.0, 0.0)
    upright = bool(abs(np.sin(found.spins[index])) > 0.5)
    return SuggestedView(found.poses[index], (u, v), float(found.distances[index]), tilt, nearer, upright, std)


def _spared(known: Known, seen: list[tuple[BoardDetection, Pose]]) -> tuple[tuple[str, ...], float]:
    """Return the images without which the uncertainty is hardly larger, and by which share it is."""
    views = Observations.of([view for view, _ in seen])
    poses = [pose for _, pose in seen]
    information = known.noise_share * view_information(known.camera, known.surface, views, poses, known.noise_px)
    camera, metric = known.camera, _image_metric(known)
    size, lens = information.shape[1], len(metric)
    # what is known without any view: the priors of the lens; of the terms of the board, hardly anything
    spread = camera.model.prior_std(camera.image_size, camera.value("fx"))[free_parameters(camera)]
    weak = np.full(size, 1e-3) * np.abs(np.diag(information.sum(axis=0)))[:size] / len(seen)
    weak[:lens] = spread**-2.0
    left, without = np.diag(weak) + information.sum(axis=0), []
    before = float(np.trace(np.linalg.inv(left)[:lens, :lens] @ metric))
    kept, rise = list(range(len(seen))), 0.0
    while len(kept) > _KEPT:
        trials = np.linalg.inv(left - information[kept])[:, :lens, :lens]
        variances = np.einsum("vij,ji->v", trials, metric)
        best = int(np.argmin(np.where(variances > 0, variances, np.inf)))
        if variances[best] > before * (1 + _SPARED) ** 2:
            break
        rise = float(np.sqrt(max(variances[best] / before, 1.0)) - 1)
        left = left - information[kept[best]]
        without.append(seen[kept.pop(best)][0].image)
    return tuple(without), rise


def candidates(known: Known) -> Candidates:
    """Return poses of the board that show all of it: over the image, tilted by up to 50° about axes in all directions,
    across and upright, at distances about those of the boards that were seen.

    Raises InsufficientData if there are none.
    """
    camera, board = known.camera, known.surface.board
    leans = np.array([(0.0, 0.0), *((t * np.cos(a), t * np.sin(a)) for t, a in product(_TILTS, _AZIMUTHS))])
    size = np.array(camera.image_size)
    grid = list(product(_distances(known), _ACROSS, _DOWN, range(len(leans)), _SPINS))
    distances, across, down, which, spins = (np.array(column) for column in zip(*grid, strict=True))
    leans = leans[which.astype(np.intp)]
    turn = so3.exp(np.pad(leans, ((0, 0), (0, 1)))) @ so3.exp(np.outer(spins, [0.0, 0.0, 1.0]))
    turn = turn @ np.diag([1.0, board.z_sign, board.z_sign])
    middle = np.array([*board.extent, 0.0]) / 2
    outline, aims = rim(board), np.column_stack([across, down]) * size - 0.5
    for _ in range(_STEPS):
        rotations, translations = _place(camera, aims, distances, turn, middle)
        pixels, valid = _project(camera, outline, rotations, translations)
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        moved = aims + np.maximum(-low, 0) - np.maximum(high - size + 1, 0)
        aims = np.where(np.asarray(valid.all(axis=1))[:, None], moved, aims + 0.15 * ((size - 1) / 2 - aims))
    # to a pixel: boards are moved in steps
    whole = (
        valid.all(axis=1)
        & (low > -1).all(axis=1)
        & (high < size).all(axis=1)
        & _faces_camera(outline, rotations, translations, board.z_sign)
    )
    if known.circle is not None:
        whole &= known.circle.contains(pixels.reshape(-1, 2)).reshape(len(whole), -1).all(axis=1)
    corners, valid = _project(camera, known.surface.points(), rotations, translations)
    whole &= valid.all(axis=1)
    if not whole.any():
        raise InsufficientData(
            f"no view of the whole board ({board.words}) fits the image at the distances of the others"
        )
    parts = rotations, translations, corners, leans, spins, aims, distances
    return Candidates(*(part[whole] for part in parts))


def _distances(known: Known) -> Array:
    """Return the distances of the middle of the board, in its unit."""
    if known.distances is not None:
        nearest, farthest = known.distances
        return np.asarray(np.geomspace(nearest / _MARGIN, _MARGIN * farthest, _DISTANCES))
    # of a board that faces the camera in the middle: the angle over which the image's smaller side would be
    extent, camera = max(known.surface.board.extent), known.camera
    focal = float(np.sqrt(np.prod(camera.parameters[:2])))
    nearest, farthest = (focal * extent / (fill * min(camera.image_size)) for fill in _FILLS)
    return np.asarray(np.geomspace(nearest, farthest, _DISTANCES))


def rim(board: Board) -> Array:
    """Return points (16, 3) around a board, four on each side, with as much beyond its corners as has to be seen."""
    steps = np.linspace(0, 1, 5)[:-1]
    sides = [(steps, 0 * steps), (0 * steps + 1, steps), (1 - steps, 0 * steps + 1), (0 * steps, 1 - steps)]
    reach = _BORDER * board.spacing
    flat = np.concatenate([np.column_stack(side) for side in sides]) * (np.array(board.extent) + 2 * reach) - reach
    return np.pad(flat, ((0, 0), (0, 1)))


def _place(camera: Camera, aims: Array, distances: Array, turn: Array, middle: Array) -> tuple[Array, Array]:
    """Return rotations (V, 3, 3) and translations (V, 3) of boards whose middle is seen at pixels `aims` (V, 2)."""
    sight = camera.unproject(aims)
    rays = np.where(sight.valid[:, None], sight.directions, [0.0, 0.0, 1.0])
    across = np.hypot(rays[:, 0], rays[:, 1])
    angle = np.arctan2(across, rays[:, 2]) / np.maximum(across, 1e-12)
    towards = so3.exp(np.column_stack([-rays[:, 1] * angle, rays[:, 0] * angle, 0 * angle]))
    rotations = towards @ turn
    return rotations, distances[:, None] * rays - rotations @ middle


def _project(camera: Camera, points: Array, rotations: Array, translations: Array) -> tuple[Array, BoolArray]:
    """Return the pixels (V, N, 2) of points (N, 3) of boards, and which are valid (V, N)."""
    found = camera.project((points @ np.swapaxes(rotations, 1, 2) + translations[:, None]).reshape(-1, 3))
    shape = len(rotations), len(points)
    return np.nan_to_num(found.pixels).reshape(*shape, 2), found.valid.reshape(shape)


def _faces_camera(points: Array, rotations: Array, translations: Array, z_sign: float) -> BoolArray:
    """Return which boards (V,) are nowhere seen at too small an angle to their plane."""
    placed = points @ np.swapaxes(rotations, 1, 2) + translations[:, None]
    along = z_sign * np.einsum("vni,vi->vn", placed, rotations[:, :, 2]) / np.linalg.norm(placed, axis=2)
    return np.asarray((along > np.cos(_STEEPEST)).all(axis=1))
