"""Simulated detections of one board: calibrations to trust and not to trust, for tests and benchmarks/reports.py."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose
from camcal.simulate.render import FLAT, Shape
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection, Detections

BOARD = Board("chessboard", 9, 6, 0.025)
SIZE = (1280, 960)
VIEWS = 24
NOISE_PX = 0.1
SHEAR_PX = 3.0
FLAT_DEG = 5.5


@dataclass(frozen=True)
class Scene:
    """How the board is seen: by which lens, parallel to the image or not, bent how, and what becomes of detections.

    seen_from: m, how far to the right of the camera that the poses are made for.
    """

    model: str = "opencv5"
    fov_deg: float = 70.0
    parallel: bool = False
    shape: Shape = FLAT
    seen_from: float = 0.0
    change: Callable[[BoardDetection, np.random.Generator], BoardDetection] = lambda view, _: view


def _numbered_by_columns(view: BoardDetection, _: np.random.Generator) -> BoardDetection:
    """Return a view as a program numbers it that counts down the columns of the board."""
    row, column = np.divmod(view.ids, BOARD.columns)
    return replace(view, ids=column * BOARD.rows + row)


def _sheared(view: BoardDetection, rng: np.random.Generator) -> BoardDetection:
    """Return a view whose rows were exposed one after another while the camera moved."""
    angle = rng.uniform(0, 2 * np.pi)
    moved = SHEAR_PX * np.array([np.cos(angle), np.sin(angle)])
    return replace(view, pixels=view.pixels + np.outer(view.pixels[:, 1] / view.size[1] - 0.5, moved))


SCENES: Mapping[str, Scene] = {
    "good": Scene(),
    "bent-board": Scene(shape=Shape(bow_x=0.0015, bow_y=-0.0008)),
    "flat-views": Scene(parallel=True),
    "wrong-board": Scene(change=_numbered_by_columns),
    "moving-shutter": Scene(change=_sheared),
    "fisheye": Scene(model="kannala_brandt4", fov_deg=150.0),
}


def _flattened(pose: Pose, rng: np.random.Generator) -> Pose:
    """Return a pose of the board at the same place, all but parallel to the image."""
    middle = np.array([*BOARD.extent, 0.0]) / 2
    tilt = np.radians(FLAT_DEG) * rng.uniform(-1, 1, 2)
    flat = Pose.from_vector(np.array([*tilt, 0.0]), np.zeros(3)).rotation
    return Pose(flat, pose.apply(middle) - flat @ middle)


def camera_of(scene: Scene) -> Camera:
    return make_camera(model_named(scene.model), SIZE, np.radians(scene.fov_deg))


def detections_of(scene: Scene, count: int = VIEWS, seed: int = 3) -> Detections:
    """Return what is detected of a board in `count` images."""
    rng = np.random.default_rng(seed)
    camera = camera_of(scene)
    poses = views(camera, BOARD, count, rng=rng)
    poses = [_flattened(pose, rng) for pose in poses] if scene.parallel else poses
    poses = [Pose(pose.rotation, pose.translation - [scene.seen_from, 0, 0]) for pose in poses]
    found, _ = observe(camera, BOARD, poses, rng=rng, noise_px=NOISE_PX, shape=scene.shape)
    return replace(found, views=tuple(scene.change(view, rng) for view in found.views))
