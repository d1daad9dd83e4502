"""`camcal undistort`: what it prints, its exit codes, its document."""

import json
from pathlib import Path

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import load, save

SETTINGS = Path(__file__).parents[2] / "sample_configs" / "undistort.yaml"
SIZE = (120, 80)
LENS = Camera(model_named("opencv5"), SIZE, np.array([90.0, 91, 61, 39, -0.25, 0.06, 0, 0, 0]))
FISHEYE = Camera(model_named("kannala_brandt4"), SIZE, np.array([20.0, 20, 60, 40, 0, 0, 0, 0]))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    native.write(tmp_path / "lens.yaml", CameraFile({"lens": CameraEntry(LENS)}))
    native.write(tmp_path / "fish.yaml", CameraFile({"fish": CameraEntry(FISHEYE)}))
    rng = np.random.default_rng(1)
    for name in ("1.png", "2.png", "10.png"):
        save(tmp_path / "photos" / name, rng.integers(0, 255, (80, 120, 3), dtype=np.uint8))
    return tmp_path


def test_images_and_their_camera_are_named(run, folder):
    code, out, err = run("undistort", "lens.yaml", "photos", "-o", "out")
    assert (code, err) == (0, "")
    assert out.startswith("pinhole, 120x80, fx=")
    assert out.endswith("\nwrote out/camera.yaml and 3 images to out/\n")
    verbose = run("undistort", "lens.yaml", "photos", "-o", "out", "--verbose")[1]
    assert verbose.split()[2:5] == ["out/1.png", "out/2.png", "out/10.png"]


def test_quiet_says_nothing(run, folder):
    assert run("undistort", "lens.yaml", "photos", "-o", "out", "--quiet") == (0, "", "")


def test_the_document_has_a_fixed_shape(run, folder):
    (folder / "photos" / "3.png").write_text("Dear diary")
    code, out, err = run("undistort", "lens.yaml", "photos", "-o", "out", "--mask", "--json")
    document = json.loads(out)
    assert code == 6
    failed, error = err.splitlines()
    assert failed.startswith("camcal: failed: photos/3.png: unknown image format")
    assert error == "camcal: error: 1 of 4 images failed, the rest is written"
    assert list(document) == [
        *("schema", "camera_file", "mask", "view", "images", "reused", "failed", "warnings", "error", "exit")
    ]
    assert document["schema"] == "camcal/undistort/1"
    assert document["camera_file"] == "out/camera.yaml"
    assert document["mask"] == "out/valid_mask.png"
    assert list(document["view"]) == ["model", "image_size", "parameters", "valid"]
    assert list(document["view"]["parameters"]) == ["fx", "fy", "cx", "cy"]
    first = {"source": "photos/1.png", "frame": None, "output": "out/1.png", "orientation": 1}
    assert document["images"][0] == first
    assert [item["source"] for item in document["failed"]] == ["photos/3.png"]
    assert "unknown image format" in document["failed"][0]["message"]


def test_every_option_reaches_the_images(run, folder):
    options = ["--alpha", 1, "--size", "90x60", "--interpolation", "nearest", "--border", "1,2,3", "--format", "tiff"]
    assert run("undistort", "lens.yaml", "photos/1.png", "-o", "out", "--mask", *options)[0] == 0
    image, mask = load(folder / "out" / "1.tiff").pixels, load(folder / "out" / "valid_mask.png").pixels
    assert image.shape == (60, 90, 3)
    assert (image[mask == 0] == [1, 2, 3]).all()
    command = native.read(folder / "out" / "camera.yaml").provenance["command"]
    expected = "camcal undistort lens.yaml photos/1.png --alpha 1 --size 90x60 --interpolation nearest --border 1,2,3 "
    expected += "--format tiff"
    assert command == expected


def test_settings_may_come_from_a_file(run, folder):
    assert run("undistort", "lens.yaml", "photos", "-o", "out", "--config", SETTINGS, "-q")[0] == 0
    assert load(folder / "out" / "1.png").size == (1920, 1080)
    assert (folder / "out" / "valid_mask.png").exists()


def test_a_fisheye_is_sent_to_a_projection_that_holds_it(run, folder):
    code, out, err = run("undistort", "fish.yaml", "photos", "-o", "out", "--alpha", 1)
    assert (code, out) == (2, "")
    assert "use --projection cylinder" in err
    assert not (folder / "out").exists()
    for projection in ("cylinder", "equirectangular", "stereographic"):
        code, out, _ = run("undistort", "fish.yaml", "photos", "-o", projection, "--projection", projection)
        assert code == 0
        assert out.startswith(f"{projection}, 120x80")


def test_points_are_undistorted_and_distorted_back(run, folder):
    (folder / "points.csv").write_text("u,v\n10,20\n,3\n")
    code, out, _ = run("undistort", "lens.yaml", "--points", "points.csv", "-o", "moved.csv", "--keep-k")
    assert code == 0
    assert out.splitlines()[0] == "2 points, 1 outside the lens model (empty cells)"
    code, out, _ = run(
        "undistort", "lens.yaml", "--points", "moved.csv", "--distort", "-o", "back.csv", "--keep-k", "--json"
    )
    document = json.loads(out)
    assert list(document) == ["schema", "output", "camera_file", "points", "without_place", "warnings"]
    assert (code, document["points"], document["without_place"]) == (0, 2, 1)
    back = (folder / "back.csv").read_text().splitlines()
    assert back[2] == ","
    np.testing.assert_allclose(np.array(back[1].split(","), dtype=float), [10, 20], atol=1e-8)  # 12 digits


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["lens.yaml", "-o", "out"], 2, "no images given"),
        (["lens.yaml", "nowhere", "-o", "out"], 3, "no such file"),
        (["none.yaml", "photos", "-o", "out"], 3, "none.yaml"),
        (["photos/1.png", "photos", "-o", "out"], 2, "photos/1.png: is an image or video where a camera file"),
        (["lens.yaml#right", "photos", "-o", "out"], 2, "no camera 'right'"),
        (["lens.yaml", "photos", "-o", "photos"], 2, "is an input and is not overwritten"),
        (["lens.yaml", "photos", "-o", "out", "--alpha", "2"], 2, "2 is more than 1"),
        (["lens.yaml", "photos", "-o", "out", "--size", "12"], 2, "such as 1920x1080"),
        (
            ["lens.yaml", "photos", "-o", "out", "--size", "40000x8000"],
            2,
            "320 million pixels, more than --max-pixels 300",
        ),
        (
            ["lens.yaml", "photos", "-o", "out", "--border", "red"],
            2,
            "Invalid value for '--border': 'red' is not numbers",
        ),
        (["lens.yaml", "photos", "-o", "out", "--border", "300"], 2, "300 does not fit uint8"),
        (["lens.yaml", "photos", "-o", "out", "--interpolation", "best"], 2, "use one of nearest-truncate"),
        (["lens.yaml", "photos", "-o", "out", "--format", "gif"], 2, "is not one of jpg"),
        (["lens.yaml", "photos", "-o", "out", "--distort"], 2, "--distort is for --points"),
        (["lens.yaml", "photos", "-o", "out", "--points", "p.csv"], 2, "--points takes no images"),
        (["lens.yaml", "--points", "p.csv", "-o", "out"], 3, "no such file"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(run, folder, arguments, code, words):
    found, out, err = run("undistort", *arguments)
    assert (found, out) == (code, "")
    assert words in err
    assert err.count("\n") == 1
    assert not (folder / "out").exists()


def test_images_do_not_go_to_standard_output(run, folder):
    code, out, err = run("undistort", "lens.yaml", "photos", "-o", "-")
    assert (code, out) == (2, "")
    assert err.startswith("camcal: error: --output writes only --points to standard output; name a folder for images")
    assert not (folder / "-").exists()


def test_a_lens_of_lensfun_undistorts_images_with_its_lateral_colour(run, folder):
    (folder / "lenses.xml").write_text(
        "<lensdatabase><lens><maker>M</maker><model>M Zoom 20-40mm</model><cropfactor>1.5</cropfactor><calibration>"
        '<distortion model="poly3" focal="20" k1="-0.02"/><distortion model="poly3" focal="40" k1="0.01"/>'
        '<tca model="poly3" focal="20" vr="1.01" vb="1"/></calibration></lens></lensdatabase>'
    )
    code, out, err = run("undistort", "lenses.xml#zoom@30", "photos/1.png", "-o", "out")
    assert (code, err) == (0, "")
    assert "red and blue of colour images undistorted with their own lens models" in out
    assert list(native.read(folder / "out" / "camera.yaml").cameras) == ["zoom_30"]
    code, out, err = run("convert", "lenses.xml#zoom@30", "camera.yaml", "--size", "120x80")
    assert (code, list(native.read(folder / "camera.yaml").cameras)) == (0, ["zoom_30"])
    code, out, err = run("undistort", "lenses.xml", "photos/1.png", "-o", "out")
    assert code == 2
    assert "holds 2 cameras (M_Zoom_20_40mm_20mm, M_Zoom_20_40mm_40mm); choose one" in err
