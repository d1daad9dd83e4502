"""Commands that read videos take image topics of bags: the same numbers as from the frames as images."""

import csv
import json
import re

import cv2
import numpy as np
import pytest
from bags import KINDS, START_NS, STEP_NS, camera_info, image, write_bag
from moving_board import between

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import views
from camcal.targets.board import Board

BOARD = Board("chessboard", 8, 5, 0.03)
SIZE = (480, 360)
CAMERA = Camera(model_named("pinhole"), SIZE, np.array([420.0, 422, 236, 181]))
RIGHT_T_LEFT = Pose(np.eye(3), np.array([-0.06, 0, 0]))
K = np.array([[423.0, 0, 238], [0, 424, 179], [0, 0, 1]])
LEFT, RIGHT, INFO = "/left/image_raw", "/right/image_raw", "/left/camera_info"
CALIBRATE = ("-b", "chessboard:8x5:30mm", "--model", "pinhole", "--flat-board", "--jobs", 1)


def rendered(poses):
    rng = np.random.default_rng(8)
    return [render(CAMERA, BOARD, pose, rng=rng, exposure=Exposure(noise_dn=1.0)) for pose in poses]


@pytest.fixture(scope="module")
def poses():
    return views(CAMERA, BOARD, 7, rng=np.random.default_rng(5), max_tilt=np.radians(40))


@pytest.fixture(scope="module")
def pictures(poses):
    return rendered(poses)


@pytest.fixture(scope="module")
def bags(tmp_path_factory, pictures):
    """Return the bags by kind: gray images with padded rows, and a camera_info that is somewhat off."""
    folder = tmp_path_factory.mktemp("bags")
    return {
        kind: write_bag(
            folder,
            kind,
            {
                LEFT: [image(picture, "mono8", padding=16) for picture in pictures],
                INFO: [camera_info(SIZE, K, np.zeros(5), first=kind == "bag")] * len(pictures),
            },
        )
        for kind in KINDS
    }


@pytest.fixture(scope="module")
def pair(tmp_path_factory, poses, pictures):
    right = rendered([RIGHT_T_LEFT @ pose for pose in poses])
    topics = {LEFT: [image(each, "mono8") for each in pictures], RIGHT: [image(each, "mono8") for each in right]}
    return write_bag(tmp_path_factory.mktemp("pair"), "mcap", topics)


def numbers_of(path):
    """Return the text of a camera file without the names of its images, their hashes and the command."""
    text = re.sub(r"file: \S+,|sha256: \S+", "", path.read_text(encoding="utf-8"))
    return re.sub(r'command: ".*"', "", text)


def written(folder, pictures):
    folder.mkdir()
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{number}.png"), picture)
    return folder


def test_a_bag_and_its_extracted_frames_give_the_same_camera(run, bags, pictures, tmp_path):
    assert run("calibrate", written(tmp_path / "frames", pictures), *CALIBRATE, "-o", tmp_path / "frames.yaml")[0] == 0
    for kind in ("bag", "mcap"):  # the third is calibrated from with its camera_info
        bag, output = bags[kind], tmp_path / f"{kind}.yaml"
        code, out, _ = run("calibrate", bag, *CALIBRATE, "--all-frames", "-o", output)
        assert code == 0
        assert f"{bag.name}#{LEFT}: 7 of 7 frames used" in out
        assert numbers_of(output) == numbers_of(tmp_path / "frames.yaml")


def test_sixteen_bits_give_the_same_corners_as_images_of_them(run, pictures, tmp_path):
    deep = [picture.astype(np.uint16) * 16 + 500 for picture in pictures[:2]]
    bag = write_bag(tmp_path, "bag", {LEFT: [image(each, "mono16", big=True) for each in deep]})
    tables = []
    for name, given in (("bag", bag), ("frames", written(tmp_path / "frames", deep))):
        assert run("detect", given, *CALIBRATE[:2], "--all-frames", "-o", tmp_path / f"{name}.csv")[0] == 0
        with (tmp_path / f"{name}.csv").open() as stream:
            rows = csv.DictReader(line for line in stream if not line.startswith("#"))
            tables.append([[row[key] for key in ("id", "u", "v", "suu")] for row in rows])
    assert tables[0] == tables[1]
    assert len(tables[0]) == 80


def test_camera_info_of_a_bag_is_a_camera_file(run, bags, tmp_path):
    for kind, bag in bags.items():
        code, out, _ = run("inspect", f"{bag}#{INFO}", "--json")
        [camera] = json.loads(out)["content"]["cameras"].values()
        assert (code, camera["intrinsics"]["fy"], camera["image_size"]) == (0, 424.0, [480, 360])
        assert run("convert", f"{bag}#{LEFT}", tmp_path / f"{kind}.xml", "--to", "opencv")[0] == 0
        code, _, err = run("inspect", f"{bag}#/other/camera_info")
        assert (code, "no camera 'other'" in err) == (2, True)
    guess = ("--guess", f"{bags['db3']}#{INFO}", "--fix", "cx,cy")
    assert run("calibrate", bags["db3"], *CALIBRATE, *guess, "--all-frames", "-o", tmp_path / "camera.yaml")[0] == 0
    found = native.read(tmp_path / "camera.yaml").cameras["camera"].camera
    assert (found.value("cx"), found.value("cy")) == (238, 179)
    assert abs(found.value("fx") - 420) < 3


def test_a_topic_of_a_bag_at_a_url_is_read(run, bags, tmp_path):
    url = bags["bag"].as_uri()
    assert run("detect", f"{url}#{LEFT}", *CALIBRATE[:2], "-o", tmp_path / "d.csv")[0] == 0
    code, out, _ = run("inspect", f"{url}#{INFO}")
    assert (code, out.startswith("left: ")) == (0, True)


def test_topics_of_a_bag_are_the_cameras_of_a_rig(run, pair, tmp_path):
    given = (*CALIBRATE, "--all-frames")
    assert run("rig", f"{pair}#{LEFT}", f"{pair}#{RIGHT}", *given, "-o", tmp_path / "topics.yaml")[0] == 0
    assert run("rig", pair, *given, "-o", tmp_path / "bag.yaml")[0] == 0
    assert numbers_of(tmp_path / "topics.yaml") == numbers_of(tmp_path / "bag.yaml")
    found = native.read(tmp_path / "bag.yaml")
    assert list(found.cameras) == ["left", "right"]
    assert abs(found.transforms["right_T_left"].pose.translation[0] + 0.06) < 1e-4
    code, out, _ = run(
        "pnp", "--rig", tmp_path / "bag.yaml", f"left={pair}#{LEFT}", f"right={pair}#{RIGHT}", *given[:2]
    )
    assert (code, "000006" in out) == (0, True)
    rectified = ("stereo", "rectify", tmp_path / "bag.yaml", f"{pair}#{LEFT}", f"{pair}#{RIGHT}")
    assert run(*rectified, "-o", tmp_path / "rectified")[0] == 0
    assert len(list((tmp_path / "rectified" / "right").glob("*.jpg"))) == 7


def test_a_bag_with_several_topics_asks_for_one(run, pair, tmp_path):
    code, _, err = run("calibrate", pair, *CALIBRATE, "-o", tmp_path / "c.yaml")
    assert code == 2
    assert f"{LEFT} (7 of 480x360), {RIGHT} (7 of 480x360): choose one, such as {pair}#{LEFT}" in err
    code, _, err = run("calibrate", f"{pair}#/left/imu", *CALIBRATE, "-o", tmp_path / "c.yaml")
    assert (code, f"no topic /left/imu; with images: {LEFT}, {RIGHT}" in err) == (2, True)


def test_a_track_has_the_times_of_the_headers(run, poses, tmp_path):
    """In float64, which since 1970 counts in steps of 0.24 µs; no text may lose more than that."""
    native.write(tmp_path / "camera.yaml", CameraFile({"camera": CameraEntry(CAMERA)}))
    moving = rendered([between(poses[0], poses[1], share) for share in np.linspace(0, 0.15, 4)])
    bag = write_bag(tmp_path, "db3", {LEFT: [image(each, "mono8") for each in moving]}, 10**9)
    told = [(START_NS + n * STEP_NS) / 1e9 for n in range(4)]
    for name in ("track.csv", "track.json", "track.yaml", "track.tum"):
        assert run("track", tmp_path / "camera.yaml", bag, *CALIBRATE[:2], "-o", tmp_path / name)[0] == 0
        text = (tmp_path / name).read_text(encoding="utf-8")
        times = [
            float(each) for each in re.findall(r'^(?:  +- +|  +)?(?:"?t"?: )?(1700000000\.\d+)', text, re.MULTILINE)
        ]
        assert np.abs(np.array(times) - told).max() < 3e-7


def test_frames_of_a_topic_are_undistorted_and_resumed(run, bags, tmp_path):
    given = ("undistort", f"{bags['db3']}#{INFO}", f"{bags['db3']}#{LEFT}", "-o", tmp_path / "out")
    assert run(*given)[0] == 0
    assert len(list((tmp_path / "out").glob("image_raw_*.jpg"))) == 7
    code, out, _ = run(*given, "--resume")
    assert (code, "nothing to do: 7 images complete" in out) == (0, True)


def test_bayer_topics_are_demosaiced_as_raw_frames_are(run, tmp_path):
    values = np.random.default_rng(2).integers(0, 256, (48, 64), np.uint8)
    bag = write_bag(tmp_path, "bag", {LEFT: [image(values, "bayer_grbg8"), image(values[::-1], "bayer_gbrg8")]})
    cv2.imwrite(str(tmp_path / "frame.png"), values)
    assert run("demosaic", tmp_path / "frame.png", "--pattern", "GRBG", "-o", tmp_path / "one.png")[0] == 0
    given = ("demosaic", bag, "--type", "png", "--trust-pattern", "-o", tmp_path / "out")
    assert run(*given)[0] == 0
    expected = cv2.imread(str(tmp_path / "one.png"))
    assert np.array_equal(cv2.imread(str(tmp_path / "out" / "image_raw_000000.png")), expected)
    assert (tmp_path / "out" / "image_raw_000001.png").exists()
    code, out, _ = run(*given, "--resume")
    assert (code, "nothing to do" in out) == (0, True)
    code, _, err = run(*given[:-1], tmp_path / "other", "--pattern", "RGGB")
    assert (code, "pattern GRBG in the message, RGGB by --pattern" in err) == (6, True)
