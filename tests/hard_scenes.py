"""Photographs in which a board is hard to find, with known truth: for tests and benchmarks/detection.py.

Every scene takes the same picture of a cluttered room with a board in it and spoils it in one way.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, develop, evenly_lit, light
from camcal.simulate.scene import make_camera
from camcal.targets.board import Board

SIZE = (1280, 1024)
FOV = np.radians(60)
RIM = 1.4  # squares around the corners that are in the image
SHEET = 1.75  # squares around the corners to the edge of the sheet

_CRISP = Exposure(blur_px=0.8, noise_dn=2.0, black=0.1, white=0.8)


@dataclass(frozen=True)
class Scene:
    """How a picture is taken: squares of so many pixels, tilted by up to so many degrees, and what spoils it.

    cover: share of the board's extent that a hand hides. bend: the k1 of a lens. size: of the image.
    """

    square_px: tuple[float, float] = (25, 60)
    tilt_deg: tuple[float, float] = (0, 45)
    exposure: Exposure = _CRISP
    cover: float = 0.0
    bend: float = 0.0
    size: tuple[int, int] = SIZE


PLAIN = Scene()
SCENES: Mapping[str, Scene] = {
    "plain": PLAIN,
    "blur 3 px": replace(PLAIN, exposure=replace(PLAIN.exposure, blur_px=3.0)),
    "blur 5 px": replace(PLAIN, square_px=(35, 60), exposure=replace(PLAIN.exposure, blur_px=5.0)),
    "dark, 10 DN": replace(PLAIN, exposure=replace(PLAIN.exposure, black=0.02, white=0.06, background=0.03)),
    "noise 12 DN": replace(PLAIN, exposure=replace(PLAIN.exposure, noise_dn=12.0)),
    "tilted 60-72 deg": replace(PLAIN, tilt_deg=(60, 72)),
    "covered": replace(PLAIN, cover=0.3),
    "squares 8-10 px": replace(PLAIN, square_px=(8, 10), tilt_deg=(0, 30)),
    "squares 5-7 px": replace(PLAIN, square_px=(5, 7), tilt_deg=(0, 20)),
    "barrel k1 -0.35": replace(PLAIN, bend=-0.35, square_px=(40, 80)),
    "uneven light": replace(PLAIN, exposure=replace(PLAIN.exposure, gradient=1.0, vignetting=0.6)),
    "gamma 2.2, small": replace(PLAIN, square_px=(12, 20), exposure=replace(PLAIN.exposure, gamma=2.2)),
    "16 MP": replace(PLAIN, size=(4896, 3264), square_px=(100, 250)),
    "no board": replace(PLAIN, square_px=(0, 0)),
}


def photographs(
    scene: Scene, board: Board, count: int, seed: int = 0
) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
    """Yield images (H, W) uint8 and the true pixels (N, 2) of the board's corners, None where there is no board."""
    for index in range(count):
        rng = np.random.default_rng((seed, index))
        yield photograph(scene, board, rng)


def photograph(scene: Scene, board: Board, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray | None]:
    exposure = scene.exposure
    brightness, truth = clutter(scene.size, exposure, rng), None
    if scene.square_px[1]:
        camera, pose = view(scene, board, rng)
        sheet = np.zeros(brightness.shape, np.uint8)
        cv2.fillPoly(sheet, [np.rint(outline(camera, board, pose, SHEET)).astype(np.int32)], 1)
        soft = cv2.GaussianBlur(sheet.astype(np.float64), (0, 0), exposure.blur_px)
        drawn = evenly_lit(camera, board, pose, exposure)
        brightness = np.where(soft > 0.999, drawn, brightness * (1 - soft) + exposure.white * soft)
        truth = camera.project(pose.apply(board.points())).pixels
    if scene.cover and truth is not None:
        hide(brightness, truth, scene.cover, exposure, rng)
    lit = brightness * light(scene.size, exposure, rng.uniform(0, 2 * np.pi))
    return develop(lit, exposure, rng), truth


def view(scene: Scene, board: Board, rng: np.random.Generator) -> tuple[Camera, Pose]:
    """Return a camera and the pose of a board that is whole in its image."""
    lens = {"k1": scene.bend} if scene.bend else {"k1": -0.05}
    camera = make_camera(model_named("opencv5"), scene.size, FOV, lens)
    focal = camera.parameters[0]
    for shrink in np.linspace(1, 0.5, 400):
        square_px = shrink * rng.uniform(*scene.square_px)
        tilt, azimuth = np.radians(rng.uniform(*scene.tilt_deg)), rng.uniform(0, 2 * np.pi)
        lean = Pose.from_vector(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.zeros(3)).rotation
        roll = Pose.from_vector(np.array([0.0, 0.0, rng.uniform(0, 2 * np.pi)]), np.zeros(3)).rotation
        rotation = lean @ roll
        distance = focal * board.spacing / square_px
        ray = (rng.uniform(0.2, 0.8, 2) * scene.size - np.array(scene.size) / 2) / focal
        middle = np.array([*board.extent, 0.0]) / 2
        pose = Pose(rotation, distance * np.array([*ray, 1.0]) - rotation @ middle)
        rim = outline(camera, board, pose, RIM)
        if (rim > 3).all() and (rim < np.array(scene.size) - 4).all() and clear(camera, board, pose):
            return camera, pose
    raise ValueError("no pose fits the image")


def clear(camera: Camera, board: Board, pose: Pose) -> bool:
    """Return whether all of a board is before the camera and within what the lens can show."""
    points = pose.apply(board.points())
    return bool((points[:, 2] > 0).all() and camera.project(points).valid.all())


def outline(camera: Camera, board: Board, pose: Pose, squares: float) -> np.ndarray:
    """Return pixels (K, 2) around the corners of a board, so many squares outside them."""
    ramp, low, high = np.linspace(0, 1, 9), np.zeros(9), np.ones(9)
    sides = [np.column_stack(side) for side in ((ramp, low), (high, ramp), (ramp[::-1], high), (low, ramp[::-1]))]
    loop = np.concatenate(sides)
    reach = squares * board.spacing
    flat = loop * (np.array(board.extent) + 2 * reach) - reach
    return camera.project(pose.apply(np.column_stack([flat, np.zeros(len(flat))]))).pixels


def clutter(size: tuple[int, int], exposure: Exposure, rng: np.random.Generator) -> np.ndarray:
    """Return the brightness (H, W) of a room: surfaces with sharp edges, a bookshelf, print."""
    width, height = size
    unit = width / 1280
    image = np.full((height, width), 100, np.uint8)
    for _ in range(60):
        corner = rng.uniform(-0.1, 1.1, 2) * size
        sides = rng.uniform(10, 200, 2) * unit
        box = cv2.boxPoints((corner.tolist(), sides.tolist(), rng.uniform(0, 180)))
        cv2.fillPoly(image, [np.rint(box).astype(np.int32)], rng.uniform(0, 255))
    for _ in range(25):
        place = (rng.uniform(0, 1, 2) * size).astype(int)
        word = "".join(chr(letter) for letter in rng.integers(65, 122, 12))
        ink = rng.uniform(0, 255)
        cv2.putText(image, word, place.tolist(), cv2.FONT_HERSHEY_SIMPLEX, rng.uniform(0.4, 1.5) * unit, ink, 2)
    soft = cv2.GaussianBlur(image.astype(np.float64), (0, 0), max(exposure.blur_px, 0.5))
    return exposure.black + (exposure.white - exposure.black) / 255 * soft


def hide(image: np.ndarray, truth: np.ndarray, share: float, exposure: Exposure, rng: np.random.Generator) -> None:
    """Cover a part of a board from its rim on, in place."""
    low, high = truth.min(axis=0), truth.max(axis=0)
    rim = truth[rng.integers(len(truth))]
    radius = share / 2 * float(np.min(high - low))
    cv2.circle(image, np.rint(rim).astype(int).tolist(), int(radius), exposure.background * 1.2, -1)
