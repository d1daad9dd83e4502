"""The pairs of cameras that `camcal inspect` shows of a rig, and the lines of its picture."""

import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.report.rig_scene import COLOURS, rig_scene
from camcal.targets.board import Board
from camcal.tasks.rigs.inspect_rig import inspect_rig

PINHOLE = Camera(model_named("pinhole"), (640, 480), [500.0, 500.0, 319.5, 239.5])


def placed(**headings):
    """Return a file of cameras 0.1 m apart, turned about the vertical, degrees; the first one looks ahead."""
    transforms = {}
    for index, (name, heading) in enumerate(headings.items()):
        rotation = Pose.from_vector(np.array([0.0, -np.radians(heading), 0.0]), np.zeros(3)).rotation
        transforms[f"{name}_T_a"] = Transform(Pose(rotation, -rotation @ np.array([0.1 * (index + 1), 0.0, 0.0])))
    return CameraFile(dict.fromkeys(["a", *headings], CameraEntry(PINHOLE)), transforms)


def test_a_camera_is_compared_with_the_first_or_with_one_that_sees_the_same():
    found = inspect_rig(placed(b=5, c=180, d=175), "rig.yaml")
    assert [(pair.first, pair.second) for pair in found.pairs] == [("a", "b"), ("a", "c"), ("c", "d")]


def test_cameras_that_no_transform_joins_are_no_rig():
    assert inspect_rig(CameraFile(dict.fromkeys("ab", CameraEntry(PINHOLE))), "rig.yaml") is None
    assert inspect_rig(CameraFile({"a": CameraEntry(PINHOLE)}), "rig.yaml") is None


def test_lines_of_the_picture_are_where_cameras_and_boards_are():
    rig = inspect_rig(placed(b=0), "rig.yaml").rig
    board, away = Board("chessboard", 5, 4, 0.1), Pose(np.eye(3), np.array([0.0, 0.0, 2.0]))
    scene = rig_scene(rig, [away], board)
    by_colour = {
        name: scene.points[(scene.colours == colour).all(axis=1)] for name, colour in list(COLOURS.items())[:2]
    }
    assert np.linalg.norm(by_colour["blue"], axis=1).min() < 1e-6
    assert np.linalg.norm(by_colour["orange"] - [0.1, 0, 0], axis=1).min() < 1e-6
    outline = scene.points[scene.points[:, 2] > 1.9]
    np.testing.assert_allclose(np.ptp(outline, axis=0), [0.4, 0.3, 0.0], atol=1e-6)
    without_size = rig_scene(rig, [away], Board("chessboard", 5, 4))
    assert without_size.points[:, 2].max() < 1.9
