"""Simulated captures of several boards by the cameras of a rig, with known truth: numpy and cv2.projectPoints alone.

Nothing of camcal is used for it but its records. Boards are joined to one body, or each moves by itself. A view counts
if half of the board's points at least lie within the image and the camera sees its printed side.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from camcal.calibrate.rigs.record import Captures
from camcal.targets.board import Board
from camcal.targets.board_set import BoardSet, board_set
from camcal.targets.detection import BoardDetection

SIZE = (1280, 960)
MARGIN, LEAST_SHARE, FACING, REACH = 8.0, 0.5, 0.35, 1.2  # px, of the points, cosine, tangent


def transform(vector: Sequence[float], shift: Sequence[float] = (0, 0, 0)) -> np.ndarray:
    """Return a 4 × 4 transform by a rotation vector and a translation."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = cv2.Rodrigues(np.array(vector, float))[0], shift
    return result


def looking(place: np.ndarray, at: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """Return camera_T_world of a camera at a place that looks at another one, y of the world downwards."""
    forward = (at - place) / np.linalg.norm(at - place)
    right = np.cross([0, 1.0, 0], forward)
    right /= np.linalg.norm(right)
    world_T_camera = np.eye(4)
    world_T_camera[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    world_T_camera[:3, 3] = place
    return transform([0, 0, roll]) @ np.linalg.inv(world_T_camera)


@dataclass(frozen=True, eq=False)
class BodyScene:
    """lenses: matrix (3, 3) and coefficients (5,) of every camera; cameras: camera_T_world. boards: by their names;
    on_body: body_T_board. motions: world_T_body of each moment, or of each board by itself. printed: the size of each
    board over that in its drawing.
    """

    lenses: Mapping[str, tuple[np.ndarray, np.ndarray]]
    cameras: Mapping[str, np.ndarray]
    boards: Mapping[str, Board]
    on_body: Mapping[str, np.ndarray]
    motions: Mapping[str, Sequence[np.ndarray]]
    printed: Mapping[str, float] = field(default_factory=dict)

    @property
    def together(self) -> BoardSet:
        return board_set(self.boards)

    def relative(self, camera: str) -> np.ndarray:
        """Return camera_T_first of a camera."""
        return self.cameras[camera] @ np.linalg.inv(next(iter(self.cameras.values())))

    def points(self, board: str) -> np.ndarray:
        """Return the points (C, 3) of a board as printed, its middle where it is drawn."""
        middle = np.array([*self.boards[board].extent, 0.0]) / 2
        return middle + self.printed.get(board, 1.0) * (self.boards[board].points() - middle)

    def pose_of(self, camera: str, board: str, moment: int) -> np.ndarray:
        """Return camera_T_board."""
        return self.cameras[camera] @ self.motions[board][moment] @ self.on_body[board]


def captures_of(
    scene: BodyScene,
    noise: float = 0.1,
    seed: int = 0,
    shows: Callable[[str, str, int], bool] = lambda camera, board, moment: True,
) -> Captures:
    """Return what the cameras see, a row for each board of each moment; shows: which boards a camera sees at all."""
    rng, together = np.random.default_rng([seed, 7]), scene.together
    names, rows, moments, places = [], [], [], []
    for place, board in enumerate(scene.boards):
        for moment in range(len(scene.motions[board])):
            row = [
                view_of(scene, camera, board, moment, noise, rng) if shows(camera, board, moment) else None
                for camera in scene.cameras
            ]
            if any(view is not None for view in row):
                names.append(f"{moment:04d} {board}")
                rows.append(tuple(None if view is None else together.numbered(board, view) for view in row))
                moments.append(moment)
                places.append(place)
    return Captures(tuple(scene.cameras), tuple(names), tuple(rows), tuple(moments), tuple(places))


def view_of(
    scene: BodyScene, camera: str, board: str, moment: int, noise: float, rng: np.random.Generator
) -> BoardDetection | None:
    """Return what a camera sees of a board, numbered on it, None where it does not see it."""
    pose, points = scene.pose_of(camera, board, moment), scene.points(board)
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    middle = seen.mean(axis=0)
    towards = scene.boards[board].z_sign * pose[:3, 2] @ middle / np.linalg.norm(middle)
    if seen[:, 2].min() < 0.05 or towards < FACING:
        return None
    pixels = cv2.projectPoints(points, pose[:3, :3], pose[:3, 3], *scene.lenses[camera])[0].reshape(-1, 2)
    kept = ((pixels > MARGIN) & (pixels < np.array(SIZE) - 1 - MARGIN)).all(axis=1)
    kept &= np.hypot(*(seen[:, :2] / seen[:, 2:]).T) < REACH
    if kept.sum() < max(6, LEAST_SHARE * len(points)):
        return None
    ids = np.flatnonzero(kept)
    pixels = pixels[ids] + noise * rng.normal(size=(len(ids), 2))
    return BoardDetection(f"{camera}_{moment:04d}.png", SIZE, ids, pixels, camera=camera)


def lens(rng: np.random.Generator, focal: float = 900.0) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix and coefficients of a lens near a usual one."""
    fx = focal + 10 * rng.normal()
    matrix = np.array([[fx, 0, 640 + 8 * rng.normal()], [0, fx + rng.normal(), 480 + 8 * rng.normal()], [0, 0, 1]])
    usual, spread = np.array([-0.2, 0.08, 5e-4, -3e-4, -0.01]), np.array([0.01, 0.01, 2e-4, 2e-4, 2e-3])
    return matrix, usual + spread * rng.normal(size=5)


def two_sides(
    seed: int, moments: int = 40, *, turns: Sequence[float] = (0.6, 0.6, 0.5), per_side: int = 4
) -> BodyScene:
    """Return cameras around a panel with a board on each of its sides: `per_side` see the one, as many the other.

    turns: rad, by which the panel turns at most about its horizontal and vertical axis and its normal.
    """
    rng = np.random.default_rng([seed, 1])
    lenses, cameras = {}, {}
    for side, z in (("north", -1.3), ("south", 1.3)):
        for index in range(per_side):
            place = np.array([-0.45 + 0.3 * index, 0.1 * (index % 2), z]) + 0.03 * rng.normal(size=3)
            lenses[f"{side}{index}"] = lens(rng)
            cameras[f"{side}{index}"] = looking(place, 0.05 * rng.normal(size=3), 0.1 * rng.normal())
    boards = {"a": Board("chessboard", 9, 6, 0.05), "b": Board("chessboard", 8, 5, 0.05)}
    shift = np.array([0.38, 0.02, 0.05]) + 0.01 * rng.normal(size=3)
    on_body = {
        "a": np.eye(4),
        "b": transform([0, 0, 0], shift) @ transform([0, np.pi, 0]) @ transform(0.05 * rng.normal(size=3)),
    }
    centred, motions = transform([0, 0, 0], [-0.2, -0.125, -0.025]), []
    for _ in range(moments):
        place = rng.uniform(-1, 1, 3) * [0.35, 0.25, 0.3]
        tilt, turn = rng.uniform(-1, 1, 2) * turns[:2], rng.uniform(-1, 1) * turns[2]
        motions.append(transform([*tilt, 0], place) @ transform([0, 0, turn]) @ centred)
    return BodyScene(lenses, cameras, boards, on_body, {"a": motions, "b": motions})


def cube(
    seed: int, moments: int = 30, cameras: int = 4, boards: Mapping[str, Board] | None = None, side: float = 0.3
) -> BodyScene:
    """Return cameras in a ring around a cube with a board on each of its faces, turned any way."""
    rng = np.random.default_rng([seed, 2])
    sizes = ((5, 4), (6, 3), (7, 4), (6, 5), (7, 2), (8, 3))
    boards = boards or {f"f{face}": Board("chessboard", *size, 0.03) for face, size in enumerate(sizes)}
    axes = ([0, 0, 0], [0, np.pi / 2, 0], [0, np.pi, 0], [0, -np.pi / 2, 0], [np.pi / 2, 0, 0], [-np.pi / 2, 0, 0])
    on_cube = {}
    for (name, board), axis in zip(boards.items(), axes, strict=False):
        width, height = board.extent
        # z of a chessboard points into the cube, so that its face is at z = -side / 2
        on_cube[name] = transform(axis) @ transform(0.02 * rng.normal(size=3), [-width / 2, -height / 2, -side / 2])
    root = np.linalg.inv(next(iter(on_cube.values())))
    lenses, placed = {}, {}
    for index in range(cameras):
        angle = 2 * np.pi * index / cameras + 0.1 * rng.normal()
        place = np.array([np.sin(angle), 0.15 * rng.normal(), -np.cos(angle)]) * 0.9
        lenses[f"c{index}"], placed[f"c{index}"] = lens(rng), looking(place, 0.03 * rng.normal(size=3))
    motions = []
    for _ in range(moments):
        turn = rng.normal(size=3)
        turn *= rng.uniform(0, np.pi) / np.linalg.norm(turn)
        motions.append(transform(turn, rng.uniform(-1, 1, 3) * 0.1) @ np.linalg.inv(root))
    on_body = {name: root @ pose for name, pose in on_cube.items()}
    return BodyScene(lenses, placed, boards, on_body, dict.fromkeys(boards, motions))
