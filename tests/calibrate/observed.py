"""A rig of synthetic views whose truth is known; the noise is drawn anew for each seed."""

from dataclasses import dataclass, replace

import numpy as np

from camcal.calibrate.problem import State
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

SIZE = (1600, 1200)
PARAMETERS = {
    "pinhole": [1200.0, 1205.0, 805.0, 590.0],
    "opencv5": [1200.0, 1205.0, 805.0, 590.0, -0.12, 0.06, 0.0005, -0.0003, 0.01],
    "opencv8": [1200.0, 1205.0, 805.0, 590.0, 0.05, 0.02, 0.0005, -0.0003, 0.0, 0.15, 0.03, 0.0],
    "kannala_brandt4": [520.0, 521.0, 803.0, 596.0, 0.02, -0.01, 0.004, -0.001],
    "kannala_brandt5t": [520.0, 521.0, 803.0, 596.0, 0.02, -0.01, 0.004, -0.001, 0.0001, 0.003, -0.002],
}


@dataclass(frozen=True)
class Scene:
    camera: Camera
    board: Board
    poses: tuple

    def observe(self, seed, **how):
        return observe(self.camera, self.board, self.poses, rng=np.random.default_rng(seed), **how)[0].views


def make_scene(model="opencv5", board=None, count=25, seed=1, parameters=None, **how):
    board = board or Board("chessboard", 9, 6, 0.040)
    camera = Camera(model_named(model), SIZE, np.array(parameters or PARAMETERS[model]))
    return Scene(camera, board, tuple(views(camera, board, count, rng=np.random.default_rng(seed), **how)))


def true_state(scene, shape=()):
    """The state at the truth, of a board with these coefficients of its shape."""
    return State(
        np.array(scene.camera.parameters),
        np.stack([pose.rotation for pose in scene.poses]),
        np.stack([pose.translation for pose in scene.poses]),
        np.array(shape, dtype=float),
        np.zeros((scene.board.count, 3)),
    )


def turned(view, board, index):
    """The same view as a detector numbers it that starts at another end of a symmetric board."""
    return replace(view, ids=board.symmetries()[index][view.ids])
