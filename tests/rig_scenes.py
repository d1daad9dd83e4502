"""Simulated captures of a board by the cameras of a rig, with known truth and with what goes wrong in practice.

Nothing of camcal is used for it but its records: pixels are those of cv2.projectPoints and cv2.fisheye.projectPoints,
rotations those of cv2.Rodrigues. The board is held in front of one camera after another, anywhere in its image, tilted
by up to 45° about both axes, turned by any angle; a pose counts if two cameras at least see enough of the board.
Corners nearer than 8 px to the border or seen at more than 75° are left out.

The board may be bent, and each of its corners printed with an error of its own. Noise is independent, or a part of it
smooth over the board and another one in every view. A board that moves has a velocity of its own in each capture, and
each camera but the first exposes a random time off: the motions of a capture's cameras are along one line.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from camcal.calibrate.rigs.record import Captures
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

MARGIN = 8.0  # px
TILT, STEEPEST = np.radians(45), np.radians(75)
LEAST_SHARE = 0.3  # of the corners, that a view has
RATE = 5.0  # captures per second
_POSE, _NOISE, _MOTION, _PRINT, _HIDDEN, _TURN = range(6)  # a random generator for each purpose


@dataclass(frozen=True, eq=False)
class Lens:
    """What a camera is: model (opencv5 or kannala_brandt4), size, fx fy cx cy and coefficients, field of view (half
    angle, rad).
    """

    model: str
    size: tuple[int, int]
    parameters: np.ndarray
    reach: float

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels (N, 2) of points (N, 3) in the camera frame, NaN beyond the field of view."""
        fx, fy, cx, cy = self.parameters[:4]
        matrix, zero = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.zeros(3)
        formula = cv2.projectPoints if self.model == "opencv5" else _fisheye_points
        seen = np.arctan2(np.linalg.norm(points[:, :2], axis=1), points[:, 2]) < self.reach
        pixels = np.full((len(points), 2), np.nan)
        if seen.any():
            pixels[seen] = formula(points[seen], zero, zero, matrix, self.parameters[4:].copy())[0].reshape(-1, 2)
        return pixels


def _fisheye_points(points: np.ndarray, *others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return cv2.fisheye.projectPoints(points[:, None], *others)


@dataclass(frozen=True, eq=False)
class Transform:
    """p_a = rotation (3, 3) @ p_b + translation (3,)."""

    rotation: np.ndarray
    translation: np.ndarray

    @classmethod
    def of(cls, vector: Sequence[float], translation: Sequence[float]) -> "Transform":
        return cls(cv2.Rodrigues(np.array(vector, float))[0], np.array(translation, float))

    def apply(self, points: np.ndarray) -> np.ndarray:
        return points @ self.rotation.T + self.translation

    def __matmul__(self, other: "Transform") -> "Transform":
        return Transform(self.rotation @ other.rotation, self.apply(other.translation))

    def inverse(self) -> "Transform":
        return Transform(self.rotation.T, -self.rotation.T @ self.translation)


@dataclass(frozen=True, eq=False)
class SimulatedRig:
    """Cameras with their poses camera_T_first, and the board that is shown to them.

    bow: m, of the middle of the board along both axes. print_error: m, standard deviation of a corner in its plane.
    """

    lenses: tuple[Lens, ...]
    poses: tuple[Transform, ...]
    board: Board
    bow: tuple[float, float] = (0.0, 0.0)
    print_error: float = 0.0
    names: tuple[str, ...] = ("left", "right", "third", "fourth", "fifth", "sixth", "seventh", "eighth")

    @property
    def cameras(self) -> tuple[str, ...]:
        return self.names[: len(self.lenses)]

    def points(self, seed: int = 0) -> np.ndarray:
        """Return the true points (C, 3) of the board, m."""
        points = self.board.points()
        half = np.array(self.board.extent) / 2
        x, y = ((points[:, :2] - half) / half).T
        points = points + np.outer(self.bow[0] * (1 - x**2) + self.bow[1] * (1 - y**2), [0, 0, 1])
        errors = np.random.default_rng([seed, _PRINT]).normal(0, self.print_error, (len(points), 2))
        return points + np.pad(errors, ((0, 0), (0, 1)))


@dataclass(frozen=True)
class Errors:
    """What the corners are off by. noise: px, of a coordinate. smooth: px, RMS of what is smooth over the board.

    motion: m, standard deviation of an axis of the board's motion until the exposure of a camera other than the first.
    hidden: share of the views that are missing. turned: whether a symmetric board is numbered at random. stated:
    whether corners come with the covariance of their noise.
    """

    noise: float = 0.1
    smooth: float = 0.0
    motion: float = 0.0
    hidden: float = 0.0
    turned: bool = False
    stated: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """A rig, and poses first_T_board of the board in each capture; a pose of another rig may hold from a capture on.

    later: (capture, poses) by which the rig is replaced. other: (camera, factor) whose board has larger squares.
    """

    rig: SimulatedRig
    boards: tuple[Transform, ...]
    later: tuple[int, tuple[Transform, ...]] | None = None
    other: tuple[int, float] | None = None


def scene(rig: SimulatedRig, captures: int, seed: int, *, fill: tuple[float, float] = (0.35, 0.75)) -> Scene:
    """Return a rig with poses of the board; fill: share of the image height that the board takes."""
    rng, points, boards = np.random.default_rng([seed, _POSE]), rig.points(), []
    for index in range(captures):
        for attempt in range(3000):
            pose = _held(rig, index % len(rig.lenses), fill, rng, shrink=0.93 ** (attempt // 15))
            views = [_visible(lens, (own @ pose), points) for lens, own in zip(rig.lenses, rig.poses, strict=True)]
            if sum(visible.mean() > LEAST_SHARE for visible, _ in views) >= min(2, len(views)):
                boards.append(pose)
                break
        else:
            raise ValueError(f"no pose of the board that two of the cameras see, seed {seed}")
    return Scene(rig, tuple(boards))


def _held(rig: SimulatedRig, camera: int, fill: tuple[float, float], rng: np.random.Generator, shrink: float):
    """Return first_T_board of a board in front of a camera."""
    lens = rig.lenses[camera]
    width, height = lens.size
    side = max(rig.board.extent)
    centre = np.array(rig.board.extent) / 2
    distance = lens.parameters[0] * side / (shrink * rng.uniform(*fill) * height)
    pixel = rng.uniform([0.1 * width, 0.1 * height], [0.9 * width, 0.9 * height])
    angles = (pixel - lens.parameters[2:4]) / lens.parameters[:2]
    angle = np.linalg.norm(angles)
    if lens.model == "opencv5":
        angle = np.arctan(angle)
    direction = np.append(np.sin(angle) * angles / max(np.linalg.norm(angles), 1e-9), np.cos(angle))
    facing = _between(np.array([0, 0, 1.0]), direction)
    tilt = cv2.Rodrigues(np.append(rng.uniform(-TILT, TILT, 2), 0.0))[0]
    roll = cv2.Rodrigues(np.array([0, 0, rng.uniform(-np.pi, np.pi)]))[0]
    rotation = facing @ tilt @ roll
    translation = distance * direction - rotation @ np.append(centre, 0)
    return rig.poses[camera].inverse() @ Transform(rotation, translation)


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the least rotation that takes one direction to another."""
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis)
    return cv2.Rodrigues(axis * (np.arctan2(sine, a @ b) / max(sine, 1e-12)))[0]


def _visible(lens: Lens, camera_T_board: Transform, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask (C,) of the corners that a camera sees, and all pixels (C, 2)."""
    placed = camera_T_board.apply(points)
    pixels = lens.project(placed)
    width, height = lens.size
    with np.errstate(invalid="ignore"):
        inside = (pixels > MARGIN).all(axis=1) & (pixels < [width - 1 - MARGIN, height - 1 - MARGIN]).all(axis=1)
    steep = np.arccos(np.clip(placed @ camera_T_board.rotation[:, 2] / np.linalg.norm(placed, axis=1), -1, 1))
    return inside & (steep < STEEPEST), pixels


def observed(scene: Scene, errors: Errors, seed: int) -> Captures:
    """Return what the cameras of a scene saw, measured with errors."""
    rig, count = scene.rig, len(scene.boards)
    points = rig.points()
    noise, motion, hidden, turn = (np.random.default_rng([seed, own]) for own in (_NOISE, _MOTION, _HIDDEN, _TURN))
    missing = hidden.random((count, len(rig.lenses))) < errors.hidden
    symmetries = rig.board.symmetries()
    rows = []
    for index, board in enumerate(scene.boards):
        poses = rig.poses if scene.later is None or index < scene.later[0] else scene.later[1]
        velocity, spin = motion.normal(0, 1, (2, 3))
        row: list[BoardDetection | None] = []
        for camera, (lens, pose) in enumerate(zip(rig.lenses, poses, strict=True)):
            delay = motion.normal() * (camera > 0)
            scale = scene.other[1] if scene.other is not None and scene.other[0] == camera else 1.0
            moved = _moved(scale * points, errors.motion * delay * velocity, errors.motion * delay * spin, rig.board)
            visible, pixels = _visible(lens, pose @ board, moved)
            pixels = pixels + _errors(rig.board, errors, noise)
            ids = np.flatnonzero(visible)
            turned = symmetries[turn.integers(len(symmetries)) if errors.turned else 0]
            if len(ids) < LEAST_SHARE * len(points) or missing[index, camera]:
                row.append(None)
                continue
            covariance = np.tile(errors.noise**2 * np.eye(2), (len(ids), 1, 1)) if errors.stated else None
            time = index / RATE + (1e-3 * delay if errors.motion else 0.0)
            name = rig.cameras[camera]
            view = BoardDetection(
                f"{name}{index:04d}.png", lens.size, ids, pixels[ids], covariance, camera=name, time=time
            )
            row.append(view.renumbered(turned))
        rows.append(tuple(row))
    return Captures(rig.cameras, tuple(f"{index:04d}" for index in range(count)), tuple(rows))


def _moved(points: np.ndarray, shift: np.ndarray, turn: np.ndarray, board: Board) -> np.ndarray:
    """Return points after a motion of the board; turn: the motion of its edge, m."""
    centre = points.mean(axis=0)
    rotation = cv2.Rodrigues(turn / (max(board.extent) / 2))[0]
    return (points - centre) @ rotation.T + centre + shift


def _errors(board: Board, errors: Errors, rng: np.random.Generator) -> np.ndarray:
    """Return errors (C, 2) px of the corners of one view."""
    own = rng.normal(0, errors.noise, (board.count, 2))
    x, y = (2 * board.points()[:, :2] / max(board.extent) - 1).T
    waves = []
    for _ in range(6):
        frequency, phase, size = rng.normal(0, 2.0, (2, 2)), rng.uniform(0, 2 * np.pi, 2), rng.normal(size=2)
        waves.append(size * np.cos(np.column_stack([x, y]) @ frequency + phase))
    return own + errors.smooth * np.sqrt(2 / 6) * np.sum(waves, axis=0)


# rigs


def narrow_lens(rng: np.random.Generator, size: tuple[int, int], focal: float) -> Lens:
    """Return an ordinary lens with its own errors of centring and distortion."""
    centre = np.array(size) / 2 + rng.normal(0, 0.01, 2) * size
    strong = rng.uniform(-0.25, 0.1)
    coefficients = [strong, -0.3 * strong, rng.normal(0, 5e-4), rng.normal(0, 5e-4), 0.0]
    parameters = np.array([focal, focal * rng.uniform(0.998, 1.002), *centre, *coefficients])
    return Lens("opencv5", size, parameters, 1.1 * float(np.arctan(np.hypot(*size) / 2 / focal)))


def wide_lens(rng: np.random.Generator, size: tuple[int, int], focal: float) -> Lens:
    centre = np.array(size) / 2 + rng.normal(0, 0.01, 2) * size
    coefficients = [rng.uniform(-0.03, 0.03), rng.normal(0, 0.005), rng.normal(0, 1e-3), rng.normal(0, 2e-4)]
    parameters = np.array([focal, focal * rng.uniform(0.998, 1.002), *centre, *coefficients])
    return Lens("kannala_brandt4", size, parameters, np.radians(85))


BOARDS = (
    Board("chessboard", 9, 6, 0.025),
    Board("chessboard", 10, 7, 0.030),
    Board("chessboard", 12, 9, 0.020),
    Board("chessboard", 8, 5, 0.040),
)
SYMMETRIC = (Board("chessboard", 8, 6, 0.030), Board("chessboard", 9, 7, 0.025), Board("chessboard", 6, 4, 0.045))


def random_rig(seed: int, cameras: int | None = None, *, symmetric: bool = False) -> SimulatedRig:
    """Return a rig of two to four cameras: side by side, or around the board; one in four with wide lenses."""
    rng = np.random.default_rng([seed, 77])
    count = cameras or int(rng.integers(2, 5))
    boards = SYMMETRIC if symmetric else BOARDS
    board = replace(boards[seed % len(boards)])
    width = int(rng.choice([640, 1280, 1600]))
    size = (width, 3 * width // 4)
    wide = rng.random() < 0.25
    focal = width * (rng.uniform(0.27, 0.33) if wide else rng.uniform(0.7, 1.3))
    make = wide_lens if wide else narrow_lens
    lenses = tuple(make(rng, size, focal * rng.uniform(0.97, 1.03)) for _ in range(count))
    distance = focal * max(board.extent) / (0.5 * size[1])
    around = rng.random() < 0.4
    poses = [Transform.of([0, 0, 0], [0, 0, 0])]
    for index in range(1, count):
        shake = rng.normal(0, 0.02, 3)
        if around:
            turn = Transform.of([0, index * rng.uniform(0.2, 0.35), 0], [0, 0, 0])
            pivot = np.array([0, 0, distance])
            poses.append(Transform(_turn(shake) @ turn.rotation, pivot - _turn(shake) @ turn.rotation @ pivot))
        else:
            place = -np.array([index * distance * rng.uniform(0.12, 0.25), 0, 0]) + rng.normal(0, 0.01, 3) * distance
            poses.append(Transform(_turn(shake), place))
    side = max(board.extent)
    bow = (rng.normal(0, 2e-3) * side, rng.normal(0, 1e-3) * side)
    return SimulatedRig(lenses, tuple(poses), board, bow, print_error=1e-4 * side * rng.random())


def _turn(vector: np.ndarray) -> np.ndarray:
    return cv2.Rodrigues(vector)[0]


# mistakes


def slipped(captures: Captures, camera: int, start: int = 0) -> Captures:
    """Return captures in which a camera's images are one late, from a capture on: one was not written."""
    column = list(captures.of(camera))
    return _with_column(captures, camera, [*column[:start], *column[start + 1 :], None])


def exchanged(captures: Captures, camera: int, first: int, second: int) -> Captures:
    """Return captures of which two have exchanged their images of one camera."""
    column = list(captures.of(camera))
    column[first], column[second] = column[second], column[first]
    return _with_column(captures, camera, column)


def sides_exchanged(captures: Captures, which: Sequence[int], cameras: tuple[int, int] = (0, 1)) -> Captures:
    """Return captures some of which have exchanged the images of two cameras."""
    rows = [list(row) for row in captures.views]
    for index in which:
        rows[index][cameras[0]], rows[index][cameras[1]] = rows[index][cameras[1]], rows[index][cameras[0]]
    return replace(captures, views=tuple(map(tuple, rows)))


def mirrored(captures: Captures, camera: int, board: Board, which: Sequence[int] | None = None) -> Captures:
    """Return captures whose images of a camera are mirrored, with the numbers that a detector gives to corners then."""
    column = list(captures.of(camera))
    for index in range(len(column)) if which is None else which:
        view = column[index]
        if view is not None:
            pixels = view.pixels * [-1, 1] + [view.size[0] - 1, 0]
            column[index] = replace(view, pixels=pixels).renumbered(_mirrored_ids(board))
    return _with_column(captures, camera, column)


def _mirrored_ids(board: Board) -> np.ndarray:
    """Return the number that each corner gets in a mirrored image: rows or columns run the other way, so that they are
    right-handed again and the same corner square is dark.
    """
    numbers = np.arange(board.count).reshape(board.rows, board.columns)
    # an even number of inner corners is an odd one of squares: a line of those has the same colour at both ends
    return (numbers[::-1] if board.columns % 2 else numbers[:, ::-1]).ravel()


def unrelated(captures: Captures, camera: int, others: Captures) -> Captures:
    """Return captures whose images of a camera are from other captures."""
    return _with_column(captures, camera, list(others.of(camera)))


def another_pattern(captures: Captures, camera: int, other: Board) -> Captures:
    """Return captures in which one camera shows a board with another number of corners."""
    column = [
        None if view is None else replace(view.without_points(f"shows a {other.words}"), other=other)
        for view in captures.of(camera)
    ]
    return _with_column(captures, camera, column)


def _with_column(captures: Captures, camera: int, column: Sequence[BoardDetection | None]) -> Captures:
    rows = [list(row) for row in captures.views]
    for row, view in zip(rows, column, strict=True):
        row[camera] = view
    return replace(captures, views=tuple(map(tuple, rows)))
