"""`camcal view`: a cloud or a disparity map in, something to look at out."""

import importlib.util
import json
import sys

import cv2
import numpy as np
import pytest

from camcal.formats import disparity, disparity_sidecar, pointclouds
from camcal.formats.disparity_sidecar import Sidecar
from camcal.stereo.depth import VertexStream, vertex_type
from camcal.stereo.disparity import StereoGeometry

GEOMETRY = StereoGeometry(100.0, 100.0, 29.5, 19.5, 0.1)
SHAPE = (40, 60)
ROWS, COLUMNS = SHAPE


@pytest.fixture
def cloud(tmp_path):
    """A file of 900 green points on a square at 2 m."""
    vertices = np.zeros(900, vertex_type(colour=True, sigma=True))
    vertices["x"], vertices["y"] = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.5, 0.5, 30)] * 2))
    vertices["z"], vertices["green"], vertices["sigma"] = 2.0, 200, 0.01
    pointclouds.write(tmp_path / "cloud.ply", VertexStream(900, vertices.dtype, [vertices]))
    return tmp_path / "cloud.ply"


@pytest.fixture
def disparity_map(tmp_path):
    """A map of a plane at 2 m with a hole, and its sidecar, which names a gray image and the sigma of the disparity."""
    values = np.full(SHAPE, 5.0, np.float32)
    values[10:14, 10:14] = np.nan
    path = tmp_path / "disparity.tiff"
    written = disparity.write(path, values)
    cv2.imwrite(str(tmp_path / "left.png"), np.full(SHAPE, 90, np.uint8))
    disparity.write(tmp_path / "sigma.tiff", np.full(SHAPE, 0.25, np.float32))
    disparity_sidecar.write(
        path,
        Sidecar(written.scale, written.invalid, GEOMETRY, tmp_path / "left.png", tmp_path / "sigma.tiff"),
    )
    return path


def facts(page):
    return json.loads(page.read_text(encoding="utf-8").split('id="facts">')[1].split("</script>")[0])


def shown(path):
    """Return the picture of a file, red, green, blue."""
    return cv2.imread(str(path))[:, :, ::-1]


def test_a_cloud_becomes_a_page(run, tmp_path, cloud):
    code, out, err = run("view", cloud, "-o", tmp_path / "cloud.html")
    assert (code, err) == (0, "")
    assert "900 points in m, coloured by image; left camera: x right" in out
    assert facts(tmp_path / "cloud.html")["packed"]["count"] == 900


@pytest.mark.parametrize("suffix", pointclouds.SUFFIXES)
def test_every_kind_of_cloud_is_read(run, tmp_path, cloud, suffix):
    if suffix in {".las", ".laz"}:
        pytest.importorskip("laspy")
    found = pointclouds.read(cloud)
    other = tmp_path / f"other{suffix}"
    pointclouds.write(other, VertexStream(900, found.vertices.dtype, [found.vertices]))
    assert run("view", other, "-o", tmp_path / "cloud.html")[0] == 0
    assert facts(tmp_path / "cloud.html")["packed"]["count"] == 900


def test_a_disparity_map_with_its_sidecar_becomes_the_same_as_its_cloud(run, tmp_path, disparity_map):
    assert run("stereo", "cloud", disparity_map, "-o", tmp_path / "cloud.ply", "--sigma")[0] == 0
    for source in (disparity_map, tmp_path / "cloud.ply"):
        assert run("view", source, "-o", tmp_path / f"{source.suffix[1:]}.html")[0] == 0
    one, other = facts(tmp_path / "tiff.html"), facts(tmp_path / "ply.html")
    assert one == other
    assert one["packed"]["sigma"] is not None


def test_an_image_on_the_command_line_comes_before_that_of_the_sidecar(run, tmp_path, disparity_map):
    cv2.imwrite(str(tmp_path / "red.png"), np.full((*SHAPE, 3), (0, 0, 200), np.uint8))
    assert run("view", disparity_map, tmp_path / "red.png", "-o", tmp_path / "cloud.png")[0] == 0
    middle = shown(tmp_path / "cloud.png")[288, 640]
    assert middle.tolist() == [200, 0, 0]


def test_files_that_the_sidecar_names_and_are_not_there_are_done_without(run, tmp_path, disparity_map):
    for name in ("left.png", "sigma.tiff"):
        (tmp_path / name).unlink()
    code, out, err = run("view", disparity_map, "-o", tmp_path / "cloud.html")
    assert code == 0
    for name in ("left.png", "sigma.tiff"):
        assert f"disparity.tiff.json: {name} not found; not used" in err
    assert "coloured by depth" in out


def test_a_map_without_a_geometry_is_a_picture_of_itself(run, tmp_path):
    disparity.write(tmp_path / "bare.pfm", np.full(SHAPE, 5.0, np.float32))
    code, out, _ = run("view", tmp_path / "bare.pfm", "-o", tmp_path / "bare.png", "--json")
    assert code == 0
    assert json.loads(out)["points"] == 0
    assert shown(tmp_path / "bare.png").shape[0] > ROWS


@pytest.mark.parametrize("name", ["bare.html", "bare.gif"])
def test_a_map_without_a_geometry_has_no_points(run, tmp_path, name):
    disparity.write(tmp_path / "bare.pfm", np.full(SHAPE, 5.0, np.float32))
    code, _, err = run("view", tmp_path / "bare.pfm", "-o", tmp_path / name)
    assert code == 2
    assert "no geometry beside it" in err
    assert "stereo cloud" in err
    assert not (tmp_path / name).exists()


def test_an_archive_is_a_cloud_or_a_map_by_what_it_holds(run, tmp_path):
    disparity.write(tmp_path / "map.npz", np.full(SHAPE, 5.0, np.float32))
    code, out, _ = run("view", tmp_path / "map.npz", "-o", tmp_path / "map.png", "--json")
    assert (code, json.loads(out)["colour"]) == (0, "disparity")


@pytest.mark.parametrize(
    ("options", "size"),
    [
        ([], (1280, 1280)),
        (["--view", "top"], (576, 1280)),
        (["--view", "30,20", "--size", "320x200"], (200, 320)),
        (["--montage", "--size", "400x300"], (300, 400)),
    ],
)
def test_pictures(run, tmp_path, cloud, options, size):
    assert run("view", cloud, "-o", tmp_path / "cloud.png", *options)[0] == 0
    pixels = shown(tmp_path / "cloud.png")
    assert pixels.shape == (*size, 3)
    assert (pixels == [0, 200, 0]).all(axis=2).any()


@pytest.mark.parametrize("name", ["turn.gif", "turn.mp4"])
def test_videos(run, tmp_path, cloud, name):
    code, out, _ = run("view", cloud, "-o", tmp_path / name, "--frames", 3, "--size", "100x80", "--turn", 360)
    assert (code, f"wrote {tmp_path / name}" in out) == (0, True)
    video = cv2.VideoCapture(str(tmp_path / name))
    assert video.read()[1].shape == (80, 100, 3)


def test_colour_and_number_of_points_are_obeyed(run, tmp_path, cloud):
    code, out, _ = run("view", cloud, "-o", tmp_path / "c.html", "--colour", "sigma", "--max-points", 100)
    assert code == 0
    assert "100 of 900 points in m, coloured by sigma" in out
    assert facts(tmp_path / "c.html")["colour"] == "sigma"


@pytest.mark.parametrize("frame", ["ros", "x forward, y left, z up"])
def test_the_frame_of_a_cloud_may_be_said(run, tmp_path, cloud, frame):
    code, out, _ = run("view", cloud, "-o", tmp_path / "c.html", "--frame", frame)
    assert code == 0
    assert out.splitlines()[0].endswith("; x forward, y left, z up")
    assert facts(tmp_path / "c.html")["view_T_cloud"] == [[0, -1, 0], [0, 0, -1], [1, 0, 0]]


def test_a_frame_that_is_taken_for_granted_is_said(run, tmp_path, cloud):
    (tmp_path / "bare.xyz").write_text("0 0 1\n0 0.1 1\n")
    code, out, _ = run("view", tmp_path / "bare.xyz", "-o", tmp_path / "c.html", "--json")
    assert (code, json.loads(out)["frame"]) == (0, "not stated, x right, y down, z forward assumed")


def test_coordinates_of_a_map_keep_their_origin(run, tmp_path):
    header = ["ply", "format binary_little_endian 1.0", "element vertex 50"]
    header += [*(f"property double {axis}" for axis in "xyz"), "end_header", ""]
    steps = np.arange(50.0)
    places = np.stack([443000.13 + steps, 5532000.37 + steps % 7, 100 + steps % 3], axis=1)
    (tmp_path / "map.ply").write_bytes("\n".join(header).encode() + places.tobytes())
    code, out, _ = run("view", tmp_path / "map.ply", "-o", tmp_path / "c.html", "--json")
    assert code == 0
    assert json.loads(out)["frame"].endswith("; coordinates from 443000 5532000 0")
    assert facts(tmp_path / "c.html")["packed"]["origin"][0] == pytest.approx(0.13, abs=1e-6)


def test_json_says_what_was_made(run, tmp_path, cloud):
    code, out, _ = run("view", cloud, "-o", tmp_path / "cloud.html", "--json")
    assert code == 0
    assert json.loads(out) == {
        "schema": "camcal/view/1",
        "output": (tmp_path / "cloud.html").as_posix(),
        "kind": "page",
        "colour": "image",
        "points": 900,
        "shown": 900,
        "outside": 0,
        "unit": "m",
        "frame": "left camera: x right, y down, z forward",
        "warnings": [],
    }


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["cloud.ply"], "no output: set -o with a suffix of "),
        (["cloud.ply", "-o", "cloud.jpg"], ".jpg is not written; use .html, .png, .gif, .mp4, .rrd"),
        (["cloud.ply", "-o", "cloud"], "a name without a suffix is not written"),
        (["cloud.ply", "left.png", "-o", "c.html"], "a cloud has its own"),
        (["cloud.ply", "-o", "c.png", "--montage", "--view", "top"], "--montage has views of its own"),
        (["cloud.ply", "-o", "c.html", "--montage"], "--montage is for a picture, not for a page"),
        (["cloud.ply", "-o", "c.html", "--size", "640x480"], "--size is for a picture or a video, not for a page"),
        (["cloud.ply", "-o", "c.png", "--turn", "90"], "--turn is for a video, not for a picture"),
        (["cloud.ply", "-o", "c.gif", "--turn", "0"], "more than 0 and at most 360 degrees"),
        (["cloud.ply", "-o", "c.png", "--view", "behind"], "view 'behind' is not one of"),
        (["cloud.ply", "-o", "c.png", "--colour", "warm"], "colour 'warm' is unknown"),
        (["cloud.ply", "-o", "c.png", "--size", "wide"], "'wide' is not a size"),
        (["cloud.ply", "-o", "c.png", "--point-size", "0"], "0.1 to 10 times"),
        (["cloud.ply", "-o", "c.html", "--rerun"], ".html is not written; use .rrd"),
        (["cloud.ply", "-o", "c.html", "--frame", "up"], "use optical, camera, ros, opengl, enu, or words such as"),
        (["map.tiff", "-o", "c.html", "--frame", "x east, y north, z up"], "--frame is for a cloud"),
        (["notes.txt", "-o", "c.html"], "neither a point cloud nor a disparity map"),
    ],
)
def test_what_makes_no_sense_is_refused(run, tmp_path, cloud, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    for name in ("map.tiff", "notes.txt"):
        (tmp_path / name).write_bytes(b"none of it is read")
    code, _, err = run("view", *arguments)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"cloud.ply", "map.tiff", "notes.txt"}


def test_a_source_that_is_not_there_is_said_before_what_its_name_would_be(run, tmp_path, cloud):
    code, _, err = run("view", tmp_path / "cloud", "-o", tmp_path / "c.html")
    assert code == 3
    assert f"no such file. Did you mean '{cloud}'?" in err


@pytest.mark.parametrize("content", [None, b"", b"ply\nnonsense"])
def test_a_file_that_is_none_is_refused(run, tmp_path, content):
    if content is not None:
        (tmp_path / "cloud.ply").write_bytes(content)
    assert run("view", tmp_path / "cloud.ply", "-o", tmp_path / "c.html")[0] == 3


def test_a_cloud_without_points_is_too_little(run, tmp_path):
    empty = np.zeros(0, vertex_type())
    pointclouds.write(tmp_path / "empty.ply", VertexStream(0, empty.dtype, [empty]))
    code, _, err = run("view", tmp_path / "empty.ply", "-o", tmp_path / "c.html")
    assert code == 4
    assert "the cloud has no points" in err


def test_a_map_without_a_match_is_too_little(run, tmp_path):
    np.save(tmp_path / "nan.npy", np.full(SHAPE, np.nan, np.float32))
    code, _, err = run("view", tmp_path / "nan.npy", "-o", tmp_path / "a.png")
    assert code == 4
    assert "nan.npy: the map has no match to look at" in err
    assert not (tmp_path / "a.png").exists()


def test_the_map_is_not_overwritten(run, tmp_path):
    disparity.write(tmp_path / "bare.png", np.full(SHAPE, 5.0, np.float32))
    before = (tmp_path / "bare.png").read_bytes()
    code, _, err = run("view", tmp_path / "bare.png", "-o", tmp_path / "bare.png")
    assert (code, "is an input" in err) == (2, True)
    assert (tmp_path / "bare.png").read_bytes() == before


@pytest.mark.parametrize("more", [["--rerun"], ["-o", "cloud.rrd"]])
def test_without_the_extra_rerun_is_a_clear_line(run, tmp_path, cloud, monkeypatch, more):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "rerun", None)  # as if it were not installed
    code, _, err = run("view", cloud, *more)
    assert code == 2
    assert "pip install 'camcal[view]'" in err


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed")
def test_a_recording_for_rerun(run, tmp_path, cloud):
    assert run("view", cloud, "-o", tmp_path / "cloud.rrd")[0] == 0
    assert (tmp_path / "cloud.rrd").read_bytes()[:3] == b"RRF"


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="rerun-sdk is not installed")
def test_rerun_needs_a_screen(run, cloud, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    code, _, err = run("view", cloud, "--rerun")
    assert (code, "no display for Rerun: write a file with -o NAME" in err) == (2, True)
