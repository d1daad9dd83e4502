"""Commands that read videos take image topics of bags: the same numbers as from the frames as images."""

import re

import cv2
import numpy as np
import pytest
from bags import KINDS, camera_info, image, write_bag

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import views
from camcal.targets.board import Board

BOARD = Board("chessboard", 8, 5, 0.03)
SIZE = (480, 360)
CAMERA = Camera(model_named("pinhole"), SIZE, np.array([420.0, 422, 236, 181]))
TOPIC, INFO = "/left/image_raw", "/left/camera_info"
CALIBRATE = ("-b", "chessboard:8x5:30mm", "--model", "pinhole", "--flat-board", "--jobs", 1)


@pytest.fixture(scope="module")
def pictures():
    rng = np.random.default_rng(5)
    poses = views(CAMERA, BOARD, 7, rng=rng, max_tilt=np.radians(40))
    return [render(CAMERA, BOARD, pose, rng=rng, exposure=Exposure(noise_dn=1.0)) for pose in poses]


@pytest.fixture(scope="module")
def bags(tmp_path_factory, pictures):
    """Return the bags by kind: gray images with padded rows, and a camera_info that is somewhat off."""
    folder = tmp_path_factory.mktemp("bags")
    K = np.array([[423.0, 0, 238], [0, 423, 179], [0, 0, 1]])
    return {
        kind: write_bag(
            folder,
            kind,
            {
                TOPIC: [image(picture, "mono8", padding=16) for picture in pictures],
                INFO: [camera_info(SIZE, K, np.zeros(5), first=kind == "bag")] * len(pictures),
            },
        )
        for kind in KINDS
    }


def numbers_of(path, *names):
    """Return the text of a camera file without the names of its images, their hashes and the command."""
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"file: \S+,|sha256: \S+", "", text)
    return re.sub(r'command: ".*"', "", text)


def test_a_bag_and_its_extracted_frames_give_the_same_camera(run, bags, pictures, tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(frames / f"{number}.png"), picture)
    assert run("calibrate", frames, *CALIBRATE, "-o", tmp_path / "frames.yaml")[0] == 0
    for kind, bag in bags.items():
        output = tmp_path / f"{kind}.yaml"
        code, out, _ = run("calibrate", bag, *CALIBRATE, "--all-frames", "-o", output)
        assert code == 0
        assert f"{bag.name}#{TOPIC}: 7 of 7 frames used" in out
        assert numbers_of(output) == numbers_of(tmp_path / "frames.yaml")
