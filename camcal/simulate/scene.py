"""Simulated cameras, plausible board poses, and detections.

Poses are spread over the image, tilted, near and far. For a rig the board is held in front of one camera after another,
where another one has it too.
"""

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np

from camcal.arrays import Array
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera, Rig
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import FLAT, Shape
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection, Detections
from camcal.targets.pattern import QUIET, ink_reach

ROUNDS = 30  # attempts for a view that does not fit, each with a smaller board
STEPS = 12  # of moving a board back into the image and to its size
STEEPEST = np.radians(70)  # corners seen more obliquely than that are hard to find
FILL = (0.35, 0.95)  # share of the image's width or height that a whole board takes
PARTIAL_FILL = (0.7, 1.5)
PARTIAL_SHARE = 0.4  # of the corners that a cut board must show at least
RIM = 0.3  # squares of white around the drawing that must be in the image
WIDEST = 100.0  # half an image's width in focal lengths, 178.9° for a pinhole
LEG = 30  # frames of a moving board from one pose to the next
OFF_CENTRE = (0.006, -0.004)  # of the principal point, as shares of the image's width
_CAPTURE_ROUNDS = 20  # of proposals, as many as captures are wanted from every camera
_LEAST_CAMERAS = 2


@dataclass(frozen=True, eq=False)
class _Attempts:
    """Boards to be placed: pixels (V, 2) they are aimed at, shares (V,) of the image, turns (V, 3, 3), cut (V,)."""

    aim: Array
    fill: Array
    turn: Array
    cut: Array


@dataclass(frozen=True, eq=False)
class _Outline:
    """Points (K, 3) around what must be seen and around the sheet, the centre (3,), the corners (C, 3), board frame.

    upright: (3, 3), turns the board frame to x right, y down, z into the board.
    """

    rim: Array
    sheet: Array
    centre: Array
    corners: Array
    upright: Array

    @classmethod
    def of(cls, board: Board) -> "_Outline":
        centre, upright = np.array([*board.extent, 0.0]) / 2, np.diag([1.0, board.z_sign, board.z_sign])
        return cls(_loop(board, RIM), _loop(board, QUIET), centre, board.points(), upright)


def _loop(board: Board, squares: float) -> Array:
    """Return points (K, 3) on a rectangle that many squares outside the drawing."""
    ramp, low, high = np.linspace(0, 1, 7), np.zeros(7), np.ones(7)
    sides = [np.column_stack(side) for side in ((ramp, low), (ramp, high), (low, ramp), (high, ramp))]
    reach = ink_reach(board) + squares * board.spacing
    flat = np.concatenate(sides) * (np.array(board.extent) + 2 * reach) - reach
    return np.column_stack([flat, np.zeros(len(flat))])


def views(
    camera: Camera,
    board: Board,
    count: int,
    *,
    rng: np.random.Generator,
    partial: bool = False,
    max_tilt: float = np.radians(45),
) -> list[Pose]:
    """Return `count` poses camera_T_board that fill the image and make a well-conditioned calibration.

    partial: every other view may be cut by the border of the image; else all corners of all views are in it.
    max_tilt: the largest angle (rad) between the board's normal and the line of sight to its centre.
    Raises InvalidInput if no such poses are found: the image or the lens's field is too small for the board.
    """
    outline = _Outline.of(board)
    found: dict[int, Pose] = {}
    for ease in np.linspace(1, 0.4, ROUNDS):
        missing = np.array([index for index in range(count) if index not in found], dtype=np.intp)
        if not missing.size:
            return [found[index] for index in range(count)]
        attempts = _draw(camera, missing, rng, partial, max_tilt)
        attempts = replace(attempts, fill=ease * attempts.fill)
        rotations, translations = _fit_into_image(camera, outline, attempts)
        # in the lens's domain, not too oblique, with as many corners as they should have
        shown = _share_in_image(camera, outline.corners, rotations, translations)
        whole = _share_in_image(camera, outline.rim, rotations, translations) == 1
        drawn = _can_be_drawn(camera, outline, rotations, translations)
        for slot in np.flatnonzero(drawn & np.where(attempts.cut, shown >= PARTIAL_SHARE, whole)):
            found[int(missing[slot])] = Pose(rotations[slot], translations[slot])
    raise InvalidInput(
        f"no pose of the board ({board.words}) fits an image of "
        f"{camera.image_size[0]} × {camera.image_size[1]} with this lens; found {len(found)} of {count} views"
    )


def _draw(camera: Camera, slots: Array, rng: np.random.Generator, partial: bool, max_tilt: float) -> _Attempts:
    """Return attempts for the views `slots`: aims walk over a 3 × 3 grid of the image, sizes and tilts are spread."""
    count = len(slots)
    cell = np.column_stack([slots % 3, slots // 3 % 3])
    aim = (cell + rng.random((count, 2))) / 3 * np.array(camera.image_size) - 0.5
    cut = (slots % 2 == 1) & partial
    low, high = np.where(cut[:, None], PARTIAL_FILL, FILL).T
    fill = low + (high - low) * _spread(rng, count)
    tilt = max_tilt * (0.1 + 0.9 * _spread(rng, count))
    azimuth = 2 * np.pi * _spread(rng, count)
    # Mostly upright, now and then in portrait format.
    roll = rng.normal(0, np.radians(10), count) + np.pi / 2 * rng.choice([0, 1, -1], count, p=[0.8, 0.1, 0.1])
    lean = np.column_stack([tilt * np.cos(azimuth), tilt * np.sin(azimuth), np.zeros(count)])
    spin = np.column_stack([np.zeros((count, 2)), roll])
    return _Attempts(aim, fill, so3.exp(lean) @ so3.exp(spin), cut)


def _spread(rng: np.random.Generator, count: int) -> Array:
    """Return `count` numbers in [0, 1), one in each of as many equal parts, in random order."""
    return np.asarray((rng.permutation(count) + rng.random(count)) / count)


def _fit_into_image(camera: Camera, outline: _Outline, attempts: _Attempts) -> tuple[Array, Array]:
    """Return rotations (V, 3, 3) and translations (V, 3) of boards brought to their size and into the image."""
    size = np.asarray(camera.image_size)
    middle = (size - 1) / 2
    aim = attempts.aim
    distance = np.full(len(aim), 2 * float(np.linalg.norm(outline.rim[-1] - outline.rim[0])))
    rays = np.tile([0.0, 0.0, 1.0], (len(aim), 1))
    for _ in range(STEPS):
        sight = camera.unproject(aim)
        rays = np.where(sight.valid[:, None], sight.directions, rays)
        rotations, translations = _place(rays, distance, attempts.turn @ outline.upright, outline.centre)
        pixels, valid = project_all(camera, outline.rim, rotations, translations)
        whole = np.asarray(valid.all(axis=1))
        lowest, highest = pixels.min(axis=1), pixels.max(axis=1)
        growth = np.max((highest - lowest) / size, axis=1) / attempts.fill
        distance = distance * np.where(whole, np.clip(growth, 0.7, 1.5), 1.5)
        back = np.maximum(-lowest, 0) - np.maximum(highest - size + 1, 0)
        back = np.where(whole[:, None] & ~attempts.cut[:, None], back, 0)
        aim = np.where(sight.valid[:, None], aim + back, aim + 0.1 * (middle - aim))
    return rotations, translations


def _place(rays: Array, distance: Array, turn: Array, centre: Array) -> tuple[Array, Array]:
    """Return the poses of boards whose centre lies on `rays` (V, 3), facing the camera before they are turned."""
    across = np.hypot(rays[:, 0], rays[:, 1])
    angle = np.arctan2(across, rays[:, 2]) / np.maximum(across, 1e-12)
    towards = so3.exp(np.column_stack([-rays[:, 1] * angle, rays[:, 0] * angle, np.zeros(len(rays))]))
    rotations = towards @ turn
    return rotations, distance[:, None] * rays - rotations @ centre


def _share_in_image(camera: Camera, points: Array, rotations: Array, translations: Array) -> Array:
    """Return the share (V,) of points (N, 3) on the board that each of V poses has in the image."""
    pixels, valid = project_all(camera, points, rotations, translations)
    return np.asarray((valid & in_image(camera, pixels)).mean(axis=1))


def _can_be_drawn(camera: Camera, outline: _Outline, rotations: Array, translations: Array) -> Array:
    """Return the mask (V,) of poses whose whole sheet is in the lens's domain and not seen too obliquely."""
    _, valid = project_all(camera, outline.sheet, rotations, translations)
    sheet = in_camera(outline.sheet, rotations, translations)
    into = (rotations @ outline.upright)[:, :, 2]
    cosine = np.einsum("vni,vi->vn", sheet, into) / np.linalg.norm(sheet, axis=-1)
    facing = (cosine > np.cos(STEEPEST)).all(axis=1)
    return np.asarray(valid.all(axis=1) & facing)


def seen(camera: Camera, board: Board, poses: Sequence[Pose], *, partial: bool = False) -> Array:
    """Return the mask (V,) of poses camera_T_board at which an image has the whole board, or enough of it."""
    outline = _Outline.of(board)
    rotations, translations = _stack(poses)
    points, least = (outline.corners, PARTIAL_SHARE) if partial else (np.vstack([outline.rim, outline.corners]), 1.0)
    shown = _share_in_image(camera, points, rotations, translations)
    return np.asarray((shown >= least) & _can_be_drawn(camera, outline, rotations, translations))


def _stack(poses: Sequence[Pose]) -> tuple[Array, Array]:
    """Return the rotations (V, 3, 3) and translations (V, 3) of poses."""
    rotations = np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3)
    return rotations, np.array([pose.translation for pose in poses]).reshape(-1, 3)


def motion(camera: Camera, board: Board, count: int, *, rng: np.random.Generator) -> list[Pose]:
    """Return `count` poses camera_T_board of a board that moves smoothly from one of `views` to the next.

    It rests for a moment at each of them; in between it may leave the image. Raises InvalidInput as `views` does.
    """
    stops = views(camera, board, 2 + (count - 1) // LEG, rng=rng)
    legs = [divmod(index, LEG) for index in range(count)]
    shares = (frame / LEG for _, frame in legs)  # of the way, which begins and ends at rest
    pairs = ((stops[leg], stops[leg + 1]) for leg, _ in legs)
    return [_between(*pair, share**2 * (3 - 2 * share)) for pair, share in zip(pairs, shares, strict=True)]


def _between(first: Pose, last: Pose, share: float) -> Pose:
    """Return the pose a share of the way from one to another."""
    way = last.translation - first.translation
    return Pose(so3.between(first.rotation, last.rotation, share), first.translation + share * way)


@dataclass(frozen=True, eq=False)
class Truth:
    """What a set of views was made from: poses are camera_T_board, one per view.

    outliers: for every view the mask (N,) of the corners that were displaced, in the order of its detection.
    """

    camera: Camera
    board: Board
    shape: Shape
    poses: tuple[Pose, ...]
    outliers: tuple[Array, ...] = ()


def view_name(index: int) -> str:
    """Return the image name of a simulated view."""
    return f"view{index:04d}.png"


def observe(
    camera: Camera,
    board: Board,
    poses: Sequence[Pose],
    *,
    rng: np.random.Generator,
    noise_px: float = 0.0,
    shape: Shape = FLAT,
    outliers: float = 0.0,
    outlier_px: float = 6.0,
    inside: bool = True,
) -> tuple[Detections, Truth]:
    """Return the corners of a board seen from `poses` (camera_T_board), and what they were made from.

    noise_px: standard deviation per axis. outliers: the share of corners displaced by outlier_px in any direction.
    inside: drop the corners measured outside the image; those outside the lens's domain are always dropped.
    The draws depend on the numbers of views and of points only, so that two cameras or shapes meet the same noise.
    Raises InvalidInput if the noise or the share of outliers is out of range.
    """
    if noise_px < 0 or not 0 <= outliers <= 1:
        raise InvalidInput(f"noise {noise_px} must not be negative, the share of outliers {outliers} within 0…1")
    exact, valid = project_all(camera, shape.points(board), *_stack(poses))
    displaced = rng.random(valid.shape) < outliers
    angle = rng.uniform(0, 2 * np.pi, valid.shape)
    jump = outlier_px * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    pixels = exact + noise_px * rng.standard_normal(exact.shape) + displaced[..., None] * jump
    shown = valid & in_image(camera, pixels) if inside else valid
    views = tuple(_detection(camera, index, shown[index], pixels[index]) for index in range(len(poses)))
    masks = tuple(mask[kept] for mask, kept in zip(displaced, shown, strict=True))
    return Detections(board, views), Truth(camera, board, shape, tuple(poses), masks)


def project_all(camera: Camera, points: Array, rotations: Array, translations: Array) -> tuple[Array, Array]:
    """Return pixels (V, N, 2) and the mask (V, N) of board points (N, 3) under V poses (V, 3, 3), (V, 3)."""
    projection = camera.project(in_camera(points, rotations, translations).reshape(-1, 3))
    shape = (len(rotations), len(points))
    return projection.pixels.reshape(*shape, 2), projection.valid.reshape(shape)


def in_camera(points: Array, rotations: Array, translations: Array) -> Array:
    """Return board points (N, 3) in the camera frame (V, N, 3) under V poses camera_T_board (V, 3, 3), (V, 3)."""
    return np.asarray(points @ np.swapaxes(rotations, -1, -2) + translations[:, None])


def in_image(camera: Camera, pixels: Array) -> Array:
    """Return the mask (...) of pixels (..., 2) that lie within the image."""
    return np.asarray(((pixels >= -0.5) & (pixels <= np.array(camera.image_size) - 0.5)).all(axis=-1))


def _detection(camera: Camera, index: int, seen: Array, pixels: Array) -> BoardDetection:
    if not seen.any():
        return BoardDetection(view_name(index), camera.image_size, reason="no corner of the board is in the image")
    return BoardDetection(view_name(index), camera.image_size, np.flatnonzero(seen), pixels[seen])


def make_camera(
    model: CameraModel, size: tuple[int, int], fov: float, distortion: Mapping[str, float] | None = None
) -> Camera:
    """Return a camera whose images of `size` (width, height) are `fov` (rad) wide.

    distortion: coefficients by name, the others are zero; None for typical ones and a principal point off the centre.
    Raises InvalidInput if the model has no such coefficient or cannot hold the field of view.
    """
    if min(size) < 16 or max(size) > 32000:
        raise InvalidInput(f"images of {size[0]} × {size[1]} are not simulated; use 16 to 32000 a side")
    unit = _distorted(model, model.start((1, 1), 1.0), distortion)
    edge = model.project(unit, np.array([[np.sin(fov / 2), 0.0, np.cos(fov / 2)]]))
    if not 0 < fov < 2 * np.pi or not edge.valid[0] or not 0 < edge.pixels[0, 0] < WIDEST:
        raise InvalidInput(
            f"{model.name} is not invertible over a field of view of {np.degrees(fov):g}° with this distortion"
        )
    parameters = _distorted(model, model.start(size, size[0] / 2 / edge.pixels[0, 0]), distortion)
    if distortion is None:
        parameters[2:4] += np.array(OFF_CENTRE) * size[0]
    return Camera(model, size, parameters)


def _distorted(model: CameraModel, parameters: Array, distortion: Mapping[str, float] | None) -> Array:
    if distortion is None:
        distortion = model.typical
    for name, value in distortion.items():
        if name not in model.parameter_names[4:]:
            known = ", ".join(model.parameter_names[4:]) or "none"
            raise InvalidInput(f"{model.name} has no coefficient {name!r}; it has {known}")
        parameters[model.parameter_names.index(name)] = value
    return parameters


def captures(rig: Rig, board: Board, count: int, *, rng: np.random.Generator, partial: bool = False) -> list[Pose]:
    """Return `count` poses rig_T_board that two cameras see the whole board at, or with `partial` enough of it.

    Raises InvalidInput if there are not enough such poses: the cameras have no view in common.
    """
    found: list[Pose] = []
    for _ in range(_CAPTURE_ROUNDS):
        proposed = [
            [rig.rig_T_camera[name] @ pose for pose in views(camera, board, count, rng=rng, partial=partial)]
            for name, camera in rig.cameras.items()
        ]
        in_turn = list(chain(*zip(*proposed, strict=True)))
        sharing = np.sum([seen_by(rig, name, board, in_turn, partial=partial) for name in rig.cameras], axis=0)
        found += [pose for pose, cameras in zip(in_turn, sharing, strict=True) if cameras >= _LEAST_CAMERAS]
        if len(found) >= count:
            return found[:count]
    raise InvalidInput(
        f"found {len(found)} of {count} poses of the board ({board.words}) that two cameras see: use a smaller board, "
        "--partial, or cameras with more in common"
    )


def seen_by(rig: Rig, name: str, board: Board, poses: Sequence[Pose], *, partial: bool) -> Array:
    """Return the mask (V,) of poses rig_T_board at which a camera sees the board."""
    camera_T_rig = rig.rig_T_camera[name].inverse()
    return seen(rig.cameras[name], board, [camera_T_rig @ pose for pose in poses], partial=partial)
