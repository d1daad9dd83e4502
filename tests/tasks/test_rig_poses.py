"""Which images of several cameras are of one instant."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera, Rig
from camcal.errors import InvalidInput
from camcal.formats import detections
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry.pose import Pose
from camcal.progress import SILENT, Silent
from camcal.targets.board import parse_board
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.poses.pnp_observer import seen_by_rig
from camcal.tasks.poses.pnp_views import DetectionOptions

BOARD = parse_board("chessboard:4x3:10mm")
CAMERA = Camera(model_named("pinhole"), (640, 480), [500.0, 500.0, 320.0, 240.0])
FILE = CameraFile({"left": CameraEntry(CAMERA), "right": CameraEntry(CAMERA)})
BOTH = ["left", "right"]
RIG = Rig({"left": CAMERA, "right": CAMERA}, dict.fromkeys(("left", "right"), Pose.identity()))


def view(image, camera=""):
    pixels = np.random.default_rng(1).uniform(0, 400, (12, 2))
    return BoardDetection(image, (640, 480), np.arange(12), pixels, camera=camera)


def tables(tmp_path, left, right):
    for name, images in (("left", left), ("right", right)):
        detections.write(tmp_path / f"{name}.csv", Detections(BOARD, tuple(map(view, images))))
    return tuple(f"{name}={tmp_path / name}.csv" for name in ("left", "right"))


def instants(inputs):
    _, seen = seen_by_rig(RIG, FILE, inputs, DetectionOptions(), SILENT)
    return {
        observation.pose_key.image: [each.camera for each in observation.views] for observation in seen.observations
    }


@pytest.mark.parametrize(
    ("left", "right", "names"),
    [
        (["l/1.png", "l/2.png"], ["r/1.png", "r/2.png"], ["1.png", "2.png"]),
        (["left_1.png", "left_2.png"], ["right_1.png", "right_2.png"], ["1.png", "2.png"]),
        (["left01.jpg", "left02.jpg"], ["right01.jpg", "right02.jpg"], ["01.jpg", "02.jpg"]),
        (["1-left.png", "2-left.png"], ["1-right.png", "2-right.png"], ["1-png", "2-png"]),
        (["one.png"], ["other.png"], ["instant"]),
    ],
)
def test_images_of_one_name_but_for_the_camera_are_one_instant(tmp_path, left, right, names):
    assert instants(tables(tmp_path, left, right)) == dict.fromkeys(names, BOTH)


def test_an_instant_that_one_camera_saw_counts_too(tmp_path):
    found = instants(tables(tmp_path, ["1.png", "2.png"], ["2.png", "3.png"]))
    assert found == {"1.png": ["left"], "2.png": BOTH, "3.png": ["right"]}


def test_one_detections_file_may_name_the_cameras(tmp_path):
    views = tuple(view(f"{camera}/{index}.png", camera) for camera in ("left", "right") for index in (1, 2))
    detections.write(tmp_path / "both.csv", Detections(BOARD, views))
    assert instants((str(tmp_path / "both.csv"),)) == {"1.png": BOTH, "2.png": BOTH}


def test_cameras_that_never_saw_the_same_instant_are_noticed(tmp_path):
    class Listener(Silent):
        warnings = ()

        def warn(self, message):
            self.warnings = (*self.warnings, message)

    listener = Listener()
    seen_by_rig(RIG, FILE, tables(tmp_path, ["1.png", "2.png"], ["3.png", "4.png"]), DetectionOptions(), listener)
    assert listener.warnings[0].code == "no_common_instants"


def test_two_images_of_a_camera_at_one_instant_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"a/1\.png and b/1\.png are two images of camera 'left' at one instant"):
        instants(tables(tmp_path, ["a/1.png", "b/1.png"], ["1.png"]))


def test_a_board_with_a_size_and_one_without_do_not_go_together(tmp_path):
    inputs = tables(tmp_path, ["1.png"], ["1.png"])
    detections.write(tmp_path / "right.csv", Detections(replace(BOARD, square=None), (view("1.png"),)))
    with pytest.raises(InvalidInput, match="boards with and without a size; use the same --board for all cameras"):
        instants(inputs)
