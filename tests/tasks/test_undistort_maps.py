"""`camcal undistort --maps`: what other programs draw with a map is the undistorted image."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.maps import mesh_nodes, write_mesh
from camcal.images.files import load
from camcal.images.options import ViewOptions
from camcal.images.remap import build_maps
from camcal.tasks.calibration.drawing_options import UndistortOptions
from camcal.tasks.calibration.undistort import maps_document, undistort_maps

SIZE = (200, 150)
LENS = Camera(model_named("opencv5"), SIZE, [150.0, 151, 98, 77, -0.25, 0.06, 1e-3, -5e-4, 0])


@pytest.fixture
def made(tmp_path):
    native.write(tmp_path / "camera.yaml", CameraFile({"camera": CameraEntry(LENS)}))

    def make(name, **options):
        path = tmp_path / name
        return undistort_maps(UndistortOptions(str(tmp_path / "camera.yaml"), path, maps=True, **options)), path

    return make


@pytest.fixture
def image():
    smooth = cv2.GaussianBlur(np.random.default_rng(1).uniform(0, 255, SIZE[::-1]).astype(np.float32), (0, 0), 3)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX)


def exr_channels(path):
    """The channels of an uncompressed file of 32-bit channels, read by its layout."""
    content = path.read_bytes()
    names = [name for name in "ABGR" if name.encode() + b"\0\x02\0\0\0" in content[:200]]
    width, height = SIZE
    rows = np.frombuffer(content[-height * (8 + 4 * width * len(names)) :], np.uint8).reshape(height, -1)[:, 8:]
    values = np.ascontiguousarray(rows).view("<f4").reshape(height, len(names), width)
    return {name: values[:, place] for place, name in enumerate(names)}


def drawn_by_st_map(image, red, green):
    """An image drawn as compositing programs do: coordinates from the bottom left corner, pixels have half a pixel."""
    height, width = image.shape
    return map_coordinates(image, [(1 - green) * height - 0.5, red * width - 0.5], order=1, mode="nearest")


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_every_map_draws_the_undistorted_image(made, image, alpha):
    view = ViewOptions(alpha=alpha)
    report, path = made("map.npz", view=view)
    undistorted = build_maps(LENS, report.view).apply(image)
    with np.load(path) as maps:
        drawn = cv2.remap(image, maps["map_x"], maps["map_y"], cv2.INTER_LINEAR)
        valid = maps["valid"]
    np.testing.assert_allclose(drawn, undistorted, atol=1e-3)
    assert (report.valid, valid.all()) == (pytest.approx(valid.mean()), alpha == 0)
    found = exr_channels(made("map.exr", view=view)[1])
    np.testing.assert_array_equal(found["B"] == 1, valid)
    exr = drawn_by_st_map(image, found["R"].astype(float), found["G"].astype(float))
    np.testing.assert_allclose(exr[valid], undistorted[valid], atol=0.05)
    whole = load(made("map.png", view=view)[1]).pixels.astype(float)
    np.testing.assert_array_equal(whole[..., 0] == 65535, valid)
    png = drawn_by_st_map(image, whole[..., 2] / 65535, whole[..., 1] / 65535)
    np.testing.assert_allclose(png[valid], undistorted[valid], atol=0.1)


def test_a_mesh_says_how_far_each_of_its_nodes_is_from_its_source(made):
    report, path = made("ldc.txt", mesh_step=16)
    offsets = np.loadtxt(path, dtype=int)
    columns, rows = 14, 11  # over 200 x 150 pixels, the last ones beyond
    assert offsets.shape == (columns * rows, 2)
    for row, column in ((0, 0), (3, 5), (9, 12), (10, 13)):
        node = np.array([[16.0 * column, 16.0 * row]])
        source = LENS.project(report.view.unproject(node).directions).pixels[0]
        assert offsets[row * columns + column] == pytest.approx(8 * (source - node[0]), abs=0.51)
    assert "14 x 11 nodes, 16 px apart" in report.usage


def test_the_way_back_draws_the_distorted_image_again(made, image):
    report, path = made("map.npz", view=ViewOptions(alpha=1.0))
    back, back_path = made("back.npz", view=ViewOptions(alpha=1.0), distort=True)
    assert (back.camera_file, report.camera_file) == (None, path.with_suffix(".camera.yaml"))
    with np.load(path) as maps, np.load(back_path) as again:
        straight = cv2.remap(image, maps["map_x"], maps["map_y"], cv2.INTER_CUBIC)
        drawn = cv2.remap(straight, again["map_x"], again["map_y"], cv2.INTER_CUBIC)
    np.testing.assert_allclose(drawn[10:-10, 10:-10], image[10:-10, 10:-10], atol=4)  # drawn twice


def test_what_no_map_can_be_is_refused(made, tmp_path):
    with pytest.raises(InvalidInput, match=r"--maps is written as \.npz, \.exr, \.png, \.txt"):
        made("map.jpg")
    with pytest.raises(InvalidInput, match="--points and --maps: give one of them"):
        made("map.npz", points=tmp_path / "points.csv")
    with pytest.raises(InvalidInput, match=r"--maps takes no images, found photo\.png"):
        made("map.npz", inputs=("photo.png",))
    nodes = mesh_nodes(SIZE, 50)
    with pytest.raises(InvalidInput, match="1 of 20 nodes have no source: give --alpha 0, or a smaller --fov"):
        write_mesh(tmp_path / "ldc.txt", nodes, np.where(nodes[..., :1] + nodes[..., 1:] > 300, np.nan, nodes), 50)
    with pytest.raises(InvalidInput, match="offsets up to 5000 px, the unit holds 4095"):
        write_mesh(tmp_path / "ldc.txt", nodes, nodes + np.array([5000.0, 0.0]), 50)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["camera.yaml"]


def test_the_report_says_how_a_map_is_used(made):
    report, path = made("map.npz")
    assert maps_document(report) == {
        "output": path,
        "camera_file": path.with_suffix(".camera.yaml"),
        "usage": "cv2.remap(image, maps['map_x'], maps['map_y'], cv2.INTER_LINEAR)",
        "valid": 1.0,
    }
