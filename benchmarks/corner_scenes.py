"""Boards rendered under known conditions, and the least error that any estimate of their corners can have."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, develop, evenly_lit, light
from camcal.targets.board import Board

BOARD = Board("chessboard", 8, 6, 0.03)
SMALLEST = (480, 360)
FOV = np.radians(60)
SHIFT_PX = 0.02  # of the differences that the bound is made of
ROUNDING = 1 / 12  # gray levels² of a whole number
APART = 4.0  # times the blur that edges must be apart


@dataclass(frozen=True)
class Cell:
    """Conditions: blur and spacing in px, noise in 1/255 of full scale, tilt in degrees, distortion as the share of the
    radius lost at the image's corner, encoding.
    """

    blur_px: float
    noise_dn: float
    spacing_px: float
    tilt_deg: float
    distortion: float = 0.0
    gamma: float = 1.0
    depth: int = 8
    jpeg: int = 0

    @property
    def apart(self) -> bool:
        """Whether the foreshortened edges are too close for this blur."""
        return self.spacing_px * np.cos(np.radians(self.tilt_deg)) < APART * self.blur_px

    @property
    def exposure(self) -> Exposure:
        return Exposure(blur_px=self.blur_px, noise_dn=self.noise_dn, gamma=self.gamma, depth=self.depth)


@dataclass(frozen=True, eq=False)
class Scene:
    """A photograph (H, W) of a board, its true corners (N, 2) and what they were made from."""

    cell: Cell
    camera: Camera
    camera_T_board: Pose
    direction: float
    image: Array
    corners: Array


def grid() -> list[Cell]:
    """Return the cells of the benchmark: all of blur, noise, spacing and tilt, the rest in turn."""
    blurs, noises, spacings, tilts = (0.5, 0.7, 1.0, 1.6, 2.5), (1.0, 2.0, 4.0, 8.0), (12, 20, 40, 80), (0, 30, 50, 65)
    rest = [
        (0.0, 1.0, 8, 0), (0.1, 2.2, 8, 0), (0.25, 1.0, 16, 0), (0.1, 1.0, 8, 90), (0.25, 2.2, 8, 0), (0.0, 2.2, 16, 0),
        (0.0, 2.2, 8, 90),
    ]  # fmt: skip
    every = [(b, n, s, t) for b in blurs for n in noises for s in spacings for t in tilts]
    return [Cell(*main, *rest[(7 * index + index // 7) % len(rest)]) for index, main in enumerate(every)]


def scene(cell: Cell, rng: np.random.Generator) -> Scene:
    """Return a photograph of a board near the middle of the image, turned and tilted about any axis."""
    spans = np.array([BOARD.columns + 4.5, BOARD.rows + 5.5]) * cell.spacing_px
    size = tuple(int(max(least, span)) for least, span in zip(SMALLEST, spans, strict=True))
    camera = lens(size, cell.distortion)
    tilt, azimuth, roll = np.radians(cell.tilt_deg), rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi / 6, np.pi / 6)
    rotation = so3.exp(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])) @ so3.exp(np.array([0, 0, roll]))
    distance = camera.value("fx") * BOARD.spacing / cell.spacing_px
    middle = np.array([*BOARD.extent, 0.0]) / 2
    aim = np.array([*(rng.uniform(-0.5, 0.5, 2) * BOARD.spacing), distance])
    pose = Pose(rotation, aim - rotation @ middle)
    direction = rng.uniform(0, 2 * np.pi)
    shown = evenly_lit(camera, BOARD, pose, cell.exposure) * light(size, cell.exposure, direction)
    image = develop(shown, cell.exposure, rng)
    if cell.jpeg:
        image = cv2.imdecode(
            cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, cell.jpeg])[1], cv2.IMREAD_GRAYSCALE
        )
    return Scene(cell, camera, pose, direction, image, camera.project(pose.apply(BOARD.points())).pixels)


def lens(size: tuple[int, int], distortion: float) -> Camera:
    """Return a camera whose image corners are drawn inwards by a share of their radius."""
    focal = size[0] / 2 / np.tan(FOV / 2)
    middle = (np.array(size) - 1) / 2
    corner = float(np.linalg.norm(middle)) / focal  # as imaged, (1 - distortion) of where it would be
    straight = corner / (1 - distortion)
    return Camera(
        model_named("opencv5"), size, np.array([focal, focal, *middle, -distortion / straight**2, 0, 0, 0, 0])
    )


def bound(view: Scene) -> Array:
    """Return the Cramér–Rao bound (N, 2, 2) px² of every corner, from the renderer's own image and noise.

    A corner's information is in its own cell, half-way to its neighbours. Unknown besides its position are the
    directions of both edges, the blur, and black, white and tone with the light's gradient.
    """
    cell, exposure = view.cell, view.cell.exposure
    full = 255.0

    def encoded(camera: Camera, exposure: Exposure) -> Array:
        shown = evenly_lit(camera, BOARD, view.camera_T_board, exposure) * light(
            camera.image_size, exposure, view.direction
        )
        return np.asarray(full * np.clip(shown, 0, 1) ** (1 / exposure.gamma))

    def difference(which: int) -> Array:
        sides = []
        for sign in (1, -1):
            parameters = view.camera.parameters.copy()
            parameters[2 + which] += sign * SHIFT_PX
            sides.append(encoded(Camera(view.camera.model, view.camera.image_size, parameters), exposure))
        return np.asarray((sides[0] - sides[1]) / (2 * SHIFT_PX))

    image = encoded(view.camera, exposure)
    wider, narrower = (
        encoded(view.camera, Exposure(blur_px=cell.blur_px + d, gamma=cell.gamma)) for d in (SHIFT_PX, -SHIFT_PX)
    )
    maps = np.stack([difference(0), difference(1), (wider - narrower) / (2 * SHIFT_PX), image])
    places = board_places(view)
    step = 1e-3 * BOARD.spacing
    ahead = [
        view.camera.project(view.camera_T_board.apply(BOARD.points() + step * axis)).pixels for axis in np.eye(3)[:2]
    ]
    variance = cell.noise_dn**2 + (ROUNDING if cell.depth == 8 else 0.0)
    result = np.empty((BOARD.count, 2, 2))
    for index, (corner, point) in enumerate(zip(view.corners, BOARD.points(), strict=True)):
        near = (np.abs(places - point[:2] / BOARD.spacing) < 0.5).all(axis=-1)
        row, column = np.nonzero(near)
        along = [(end[index] - corner) / np.linalg.norm(end[index] - corner) for end in ahead]
        jacobian = _derivatives(maps[:, row, column], np.column_stack([column, row]) - corner, along)
        result[index] = variance * np.linalg.inv(jacobian.T @ jacobian)[:2, :2]
    return result


def _derivatives(maps: Array, offsets: Array, along: list[Array]) -> Array:
    """Return the derivatives (K, 10) of the pixels of a cell by its corner's position and what else is unknown."""
    by_position, by_blur, image = -maps[:2].T, maps[2], maps[3]
    normals = np.array([[-tangent[1], tangent[0]] for tangent in along])
    by_distance = by_position @ np.linalg.inv(normals)  # gradient = Σ by_distance_e · normal_e
    turns = [by_distance[:, edge] * (offsets @ along[edge]) for edge in (0, 1)]
    x, y = offsets.T / np.abs(offsets).max()
    level = image / image.max()
    return np.column_stack([maps[:2].T, *turns, by_blur, np.ones_like(x), level, level**2, x * level, y * level])


def board_places(view: Scene) -> Array:
    """Return where on the board every pixel (H, W, 2) looks, in squares from corner 0."""
    width, height = view.camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2).astype(float)
    rays = view.camera.unproject(pixels).directions @ view.camera_T_board.rotation
    eye = -view.camera_T_board.rotation.T @ view.camera_T_board.translation
    hits = eye + rays * (-eye[2] / rays[:, 2])[:, None]
    return np.asarray(hits[:, :2].reshape(height, width, 2) / BOARD.spacing)


def scenes(cell: Cell, count: int, seed: int) -> Iterator[Scene]:
    """Yield `count` photographs under one set of conditions."""
    rng = np.random.default_rng([seed, hash(cell) & 0xFFFFFFFF])
    for _ in range(count):
        yield scene(cell, rng)
