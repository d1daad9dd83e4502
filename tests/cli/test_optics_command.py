"""`camcal optics`: what follows from what is given, what is missing, and what it warns of."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile, ValidRegion

SAMPLES = Path(__file__).parents[2] / "sample_configs"
WEBCAM = SAMPLES / "cameras" / "webcam.yaml"
FISHEYE = SAMPLES / "cameras" / "fisheye.yaml"

LENS = ("--f", 8, "--N", 2.8, "--focus", 0.5)
PIXELS = ("--size", "2048x1536", "--pitch", 3.45)
ONE_VIEW = ("--views", 1)  # no forecast of a calibration, which most tests do not look at
KEYS = [
    *("schema", "setup", "solved", "field_of_view", "pixel_angle", "focus", "diffraction", "exposure", "image_circle"),
    *("distances", "board", "missing", "plot", "warnings"),
]


@pytest.fixture
def figures(run):
    """A function that gives the exit and the document of a command line."""

    def call(*arguments):
        code, out, _ = run("optics", *arguments, "--json")
        return code, json.loads(out)

    return call


def camera(tmp_path, more=""):
    """Write a camera file that looks to the side: cx is 40 px off the middle."""
    path = tmp_path / "camera.yaml"
    path.write_text(
        "%YAML 1.1\n---\nformat: camcal-calibration\nversion: 1\ncameras:\n  one:\n    image_size: [1280, 960]\n"
        "    model: pinhole\n    intrinsics: {fx: 800.0, fy: 800.0, cx: 599.5, cy: 479.5}\n" + more
    )
    return path


def test_a_lens_is_worked_out_in_words(run):
    code, out, err = run("optics", *LENS, *PIXELS, "--distance", "0.5,0.6", "--exposure", 5)
    assert code == 0
    for words in (
        "hyperfocal distance                 6.633        m",
        "in focus from                       0.4654       m",
        "in focus up to                      0.5401       m",
        "principal distance                  8.13         mm",
        "sensor                              7.066 x 5.299  mm     pixels times pitch",
        "at a distance\n  figure                 0.5 m   0.6 m\n  width of the field, m    0.4345  0.5214",
        "for motion blur give --speed",
        "for stereo depth give --baseline",
    ):
        assert " ".join(words.split()) in " ".join(out.split())
    assert err == "camcal: warning: 0.6 m: out of focus: blur disc 2.2 px\n"


def test_the_document_has_every_key_whether_known_or_not(figures):
    code, document = figures(*LENS, *PIXELS)
    assert code == 0
    assert list(document) == KEYS
    assert document["schema"] == "camcal/optics/1"
    assert list(document["setup"]) == [
        *("camera", "focal_mm", "focus_m", "pixel_pitch_um", "circle_of_confusion_um", "f_number", "wavelength_nm"),
        *("sensor_mm", "image_size", "sources"),
    ]
    assert list(document["field_of_view"]) == ["horizontal_deg", "vertical_deg", "diagonal_deg"]
    assert list(document["pixel_angle"]) == ["centre_deg", "corner_deg"]
    assert list(document["focus"]) == [
        *("principal_distance_mm", "magnification", "hyperfocal_m", "near_m", "far_m", "depth_of_field_m")
    ]
    assert list(document["diffraction"]) == ["airy_diameter_um", "airy_px", "contrast", "sharp_f_number"]
    assert list(document["exposure"]) == ["effective_f_number", "close_focus_stops", "exposure_value"]
    assert list(document["distances"][0]) == [
        *("distance_m", "width_m", "height_m", "pixel_mm", "corner_pixel_mm", "line_pairs_per_mm", "blur_px"),
        *("motion_px", "longest_exposure_ms", "exposure_stops", "disparity_px", "depth_error_mm"),
    ]
    assert document["missing"] == {
        "exposure value": "--exposure",
        "motion blur": "--exposure and --speed",
        "stereo depth": "--baseline",
        "image circle": "--image-circle",
    }


def test_the_field_of_view_of_a_lens_at_infinity_is_that_of_the_reference(figures):
    _, document = figures("--f", 8, "--sensor", "7.2x5.4")
    assert list(document["field_of_view"].values()) == pytest.approx([48.455, 37.299, 58.716], abs=5e-4)
    assert document["missing"]["depth of field"] == "--focus and --coc (or the pitch) and --f-number"
    assert document["missing"]["diffraction in pixels"] == "--size and --f-number"


def test_the_airy_disc_needs_no_pixels(figures, run):
    given = ("--f", 8, "--sensor", "7.2x5.4", "--N", 4)
    diffraction = figures(*given)[1]["diffraction"]
    assert diffraction["airy_diameter_um"] == pytest.approx(2.43935 * 0.55 * 4, abs=1e-4)  # 2.44 λ N
    assert diffraction["airy_px"] is None
    assert "for diffraction in pixels give --size" in run("optics", *given)[1]


def test_the_field_of_view_of_a_camera_file_is_through_its_rays(figures, tmp_path):
    _, document = figures(camera(tmp_path))
    assert document["field_of_view"]["horizontal_deg"] == pytest.approx(77.234, abs=5e-4)
    assert document["missing"]["image circle"] == "--pitch-um (or --sensor) and --image-circle"
    assert document["missing"]["depth of field"].startswith("--pitch-um (or --focal) and --focus and --coc")


def test_the_pitch_of_a_camera_file_gives_the_focal_length_and_the_focus_what_it_is_short_of_fx(figures, tmp_path):
    path = camera(tmp_path, "    sensor: {pixel_pitch_um: 10.0}\n")
    far, near = (figures(path, *focus)[1]["setup"]["focal_mm"] for focus in ((), ("--focus", 0.5)))
    assert far == pytest.approx(8.0)  # 800 px of 10 um
    assert near == pytest.approx(1 / (1 / 8.0 + 1 / 500))  # 1/f = 1/s + 1/v
    given = figures(path, "--pitch", 5)[1]["setup"]
    assert given["focal_mm"] == pytest.approx(4.0)
    assert "pixel_pitch_um" not in given["sources"]
    assert figures(path)[1]["setup"]["sources"]["pixel_pitch_um"] == "camera file"


def test_a_focal_length_and_a_camera_file_give_the_pitch(figures, tmp_path):
    document = figures(camera(tmp_path), "--f", 4)[1]
    assert document["setup"]["pixel_pitch_um"] == pytest.approx(5.0)
    assert document["setup"]["sensor_mm"] == pytest.approx([6.4, 4.8])
    assert document["warnings"] == []


def test_lengths_that_disagree_are_warned_of(figures, tmp_path):
    path = camera(tmp_path, "    sensor: {pixel_pitch_um: 10.0}\n")
    (warning,) = figures(path, "--f", 12)[1]["warnings"]
    assert (warning["code"], warning["values"]) == ("focal_length_differs", {"focal_mm": 8.0, "given_mm": 12.0})
    nominal, other = figures("--f", 8, *PIXELS, "--sensor", "1/2.8")[1]["warnings"]
    assert nominal["code"] == "nominal_sensor_format"
    assert "7.07 x 5.30 mm by pixels and pitch, 5.57 x 3.13 mm by --sensor 1/2.8" in other["text"]


def test_an_image_circle_counts_from_the_principal_point(figures, tmp_path):
    path = camera(tmp_path, "    sensor: {pixel_pitch_um: 10.0}\n")
    circle = figures(path, "--image-circle", 16)[1]
    needed = 2 * 0.010 * math.hypot(680, 480)
    assert circle["image_circle"]["needed_mm"] == pytest.approx(needed)
    assert "image circle of 16 mm too small: the sensor corners need 16.65 mm" in circle["warnings"][0]["text"]
    assert figures(path, "--image-circle", 17)[1]["warnings"] == []


def test_a_closed_aperture_is_limited_by_diffraction(figures):
    open_, closed = (figures("--f", 8, "--N", number, *PIXELS)[1] for number in (4, 8))
    assert open_["warnings"] == []
    assert "diffraction-limited: Airy disc 3.1 px" in closed["warnings"][0]["text"]
    assert "use f/5.1 or less" in closed["warnings"][0]["text"]
    red = figures("--f", 8, "--N", 4, *PIXELS, "--wavelength", 850)[1]["diffraction"]
    assert red["airy_px"] == pytest.approx(open_["diffraction"]["airy_px"] * 850 / 550)


def test_motion_is_warned_of_with_the_exposure_that_would_do(figures):
    code, document = figures(*LENS, *PIXELS, "--speed", 0.1, "--exposure", 10)
    at = document["distances"][0]
    assert code == 0
    assert at["motion_px"] == pytest.approx(0.1 * 0.01 / (0.5 * 3.45e-6 / 8.13008e-3), rel=1e-5)
    assert at["longest_exposure_ms"] == pytest.approx(10 / at["motion_px"])
    assert 2 ** at["exposure_stops"] == pytest.approx(at["motion_px"])
    (warning,) = document["warnings"]
    assert (warning["where"], warning["text"]) == ("0.5 m", "motion blur 4.7 px: expose for 2.12 ms or less")


def test_stereo_depth_grows_with_the_square_of_the_distance(figures, tmp_path):
    near, far = figures(camera(tmp_path), "--baseline", 0.1, "--distance", "1,2")[1]["distances"]
    assert near["disparity_px"] == pytest.approx(80)
    assert near["depth_error_mm"] == pytest.approx(1e3 * 0.25 / 80)
    assert far["depth_error_mm"] == pytest.approx(4 * near["depth_error_mm"])


@pytest.mark.parametrize(
    ("given", "solve", "value"),
    [
        (("--sensor", "7.2x5.4", "--focus", 0.5), "f", 8.0),
        (("--sensor", "7.2x5.4", "--f", 8), "wd", 0.5),
        (("--f", 8, "--focus", 0.5), "sensor", 7.2),
    ],
)
def test_what_fills_the_image_is_solved_and_all_else_follows(figures, given, solve, value):
    document = figures(*given, "--solve", solve, "--width", 7.2e-3 * 492 / 8)[1]  # (s - f)/f of the sensor
    assert document["solved"]["value"] == pytest.approx(value)
    assert document["distances"][0]["width_m"] == pytest.approx(0.4428)
    assert document["focus"]["principal_distance_mm"] == pytest.approx(8.13008, abs=1e-5)


def test_the_working_distance_of_a_camera_file_is_solved_through_its_rays(run, figures):
    document = figures(WEBCAM, "--solve", "wd", "--width", 1.0)[1]
    assert document["distances"][0]["width_m"] == pytest.approx(1.0)
    code, out, _ = run("optics", "--f", 8, "--focus", 1, "--solve", "sensor", "--width", 0.5)
    assert code == 0
    assert 'sensor width 4.032 mm for a width of 0.5 m; smallest format of this width 1/3.2"' in out


def test_a_board_is_planned(run, figures):
    arguments = (*LENS, *PIXELS, "--board", "chessboard:9x6:25mm", "--tilt", 20, "--distance", "0.2,0.5,0.54")
    code, document = figures(*arguments)
    board = document["board"]
    assert code == 0
    assert list(board) == [
        *("board", "tilt_deg", "least_square_px", "fits_from_m", "large_enough_to_m", "usable_m", "distances"),
        "calibration",
    ]
    near, focused, edge = board["distances"]
    assert list(near) == [
        *("distance_m", "smallest_square_px", "largest_square_px", "share", "square_for_share_mm", "noise_px"),
        *("p_wrong", "pose_std"),
    ]
    assert near["pose_std"] is None  # it does not fit
    assert near["share"] > 1
    assert document["warnings"][-1]["where"] == "0.2 m"
    assert document["warnings"][-1]["text"].startswith("board larger than the image; nearest distance 0.3")
    assert focused["noise_px"] == pytest.approx(0.1)
    assert edge["noise_px"] > 0.1  # a blur disc of one pixel
    # depth of a board: noise of a width over all points, of the order z σ / (pixels across · √points)
    assert 0.01 < focused["pose_std"]["tz_mm"] < 0.05
    assert board["usable_m"] == pytest.approx([document["focus"]["near_m"], document["focus"]["far_m"]])
    assert list(board["calibration"]["std"]) == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"]
    assert 0.1 < board["calibration"]["std"]["fx"] < 2
    out = run("optics", *arguments)[1]
    assert re.search(r"figure +0\.2 m +0\.5 m +0\.54 m\n", out)
    assert re.search(r"pose, ± tz, mm +- +0\.0\d+ +0\.0\d+\n", out)
    for words in (
        "board chessboard:9x6:25mm, tilted by 20°",
        "use it in focus between 0.4654 m and 0.5401 m",
    ):
        assert words in out


def test_tables_fit_80_columns_however_many_distances_are_asked_for(run):
    given = ("--distance", ",".join(f"{number}.75" for number in range(7)), "--speed", 1, "--exposure", 1)
    out = run("optics", *LENS, *PIXELS, *given, "--baseline", 0.1, "--board", "chessboard:9x6:25mm", *ONE_VIEW)[1]
    tables = out[out.index("at a distance") : out.index("it fits the image")]
    assert max(map(len, tables.splitlines())) <= 80
    assert tables.count("at a distance") == 1
    assert tables.count("pose, ± rz") == 2  # five distances, the other two below


def test_the_farthest_distance_of_a_board_is_found_though_squares_shrink_again_close_to_a_wide_lens(figures):
    board = ("--board", "charuco:9x7:30mm:22mm:DICT_5X5_100", "--tilt", 30, *ONE_VIEW)
    farthest = figures(FISHEYE, *board)[1]["board"]["large_enough_to_m"]
    at = figures(FISHEYE, *board, "--distance", f"{farthest:.9f}")[1]["board"]
    assert at["distances"][0]["smallest_square_px"] == pytest.approx(at["least_square_px"], rel=1e-6)


def test_a_board_of_the_size_that_is_proposed_takes_the_share_that_was_asked_for(figures):
    arguments = ("--f", 8, *PIXELS, "--distance", 1, "--share", 0.7, *ONE_VIEW, "--board")
    square = figures(*arguments, "chessboard:9x6:25mm")[1]["board"]["distances"][0]["square_for_share_mm"]
    taken = figures(*arguments, f"chessboard:9x6:{square:.6f}mm")[1]["board"]["distances"][0]["share"]
    assert taken == pytest.approx(0.7, abs=1e-5)  # of the digits of the size


def test_a_board_without_a_distance_is_planned_where_it_takes_its_share(figures):
    for given in (("--f", 8, *PIXELS), (WEBCAM,)):
        board = figures(*given, *ONE_VIEW, "--board", "chessboard:6x9:25mm")[1]["board"]
        assert board["distances"][0]["share"] == pytest.approx(0.6)


def test_a_wide_lens_sees_a_board_from_anywhere(run):
    code, out, _ = run("optics", FISHEYE, "--board", "chessboard:9x6:25mm", "--distance", 0.2, *ONE_VIEW)
    assert code == 0
    assert "it fits the image at any distance, and squares have 8 px or more up to" in out
    assert "no ray" in out  # the field is wider than 180°


def test_the_markers_of_a_board_need_more_pixels_than_its_squares(figures):
    boards = ("chessboard:9x6:30mm", "charuco:9x7:30mm:22mm:DICT_5X5_100", "charuco:9x7:30mm:22mm:DICT_4X4_50")
    given = ("--f", 8, *PIXELS, *ONE_VIEW, "--board")
    least = [figures(*given, board)[1]["board"]["least_square_px"] for board in boards]
    assert least == pytest.approx([8, 2 * 7 * 30 / 22, 2 * 6 * 30 / 22])  # two pixels a cell, with the border
    assert figures(*given, boards[1], "--least-square", 12)[1]["board"]["least_square_px"] == 12


def test_a_tag_that_is_far_is_warned_of(figures):
    small = ("--f", 8, *PIXELS, "--noise", 0.3, "--least-square", 5, "--board", "chessboard:2x2:30mm", "--distance", 4)
    assert figures(*small, "--tilt", 30)[1]["warnings"][-1]["code"] == "ambiguous_forecast"
    assert figures(*small)[1]["warnings"][-1]["code"] == "weak_rotation"


def test_no_distance_for_a_board_is_said_with_its_reasons(figures):
    warnings = figures(*LENS, *PIXELS, "--board", "chessboard:9x6:250mm")[1]["warnings"]
    assert "no usable distance for this board: it fits the image from 2.88 m" in warnings[0]["text"]
    assert "0.465 m to 0.54 m are in focus" in warnings[0]["text"]


def test_the_plot_is_written_and_named(run, tmp_path):
    code, out, _ = run("optics", *LENS, *PIXELS, "--plot", tmp_path / "blur.svg")
    assert code == 0
    assert f"wrote {tmp_path / 'blur.svg'}" in out
    assert "in focus, 0.4654 m to 0.5401 m" in (tmp_path / "blur.svg").read_text()


def test_formats_are_listed_with_what_their_name_hides(run, figures):
    code, out, _ = run("optics", "--formats")
    assert code == 0
    assert "1/2.8 inch is a name, its diagonal is about 6.4 mm and not 9.1 mm" in " ".join(out.split())
    document = figures("--formats")[1]
    assert list(document) == ["schema", "formats", "note", "warnings"]
    assert list(document["formats"][0]) == ["name", "width_mm", "height_mm", "diagonal_mm"]
    err = run("optics", "--f", 8, "--sensor", "1/2.8")[2]
    assert 'sensor format 1/2.8" is nominal, diagonal about 6.39 mm' in err


def test_the_sample_settings_are_sound(run):
    code, out, err = run("optics", "--config", SAMPLES / "optics.yaml")
    assert (code, err) == (0, "")
    assert "board chessboard:9x6:15mm, tilted by 30°" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("-v",), "too few inputs: give a CAMERA file; --focal and --sensor"),
        (("--N", 4), "too few inputs"),
        (("--f", 8, "--sensor", "1/2.8x"), "sensor format '1/2.8x' is unknown"),
        (("--f", 0), "--focal must be more than 0 and finite, found 0"),
        (("--f", "nan"), "--focal must be more than 0 and finite, found nan"),
        (("--f", "-8"), "--focal must be more than 0 and finite, found -8"),  # mm, as given
        (("--f", "1e300", "--focus", "1e308", "--N", "1e-300"), "--focal is implausible, found 1e+300"),
        ((*LENS, "--coc", f"{'9' * 400}px"), "write a diameter with its unit"),
        (("--f", 8, "--size", f"{'9' * 20}x3", "--pitch", 3), "--size: an image side of 1e+20 pixels is implausible"),
        ((WEBCAM, "--board", "chessboard:9x6:25mm", "--noise", "1e300"), "--noise and --least-square must be"),
        ((WEBCAM, "--board", "chessboard:9x6:25mm", "--least-square", 0), "--noise and --least-square must be"),
        (("--f", 8, "--sensor", "0x5"), "sensor format '0x5' is unknown"),
        ((*LENS, "--coc", "5"), "--coc '5': write a diameter with its unit"),
        (("--f", 8, "--focus", 0.005), "a lens of 8 mm makes no image of what is 5 mm away"),
        (("--f", 8, "--size", "640"), "not a size"),
        (("--f", 8, "--distance", "1,-2"), "--distance must be more than 0 m"),
        (("--f", 8, "--solve", "f", "--width", 1), "--solve f solves for --focal"),
        (("--f", 8, "--solve", "wd", "--width", 1), "--solve wd needs --sensor (or --pitch-um and --size) too"),
        (("--f", 8, "--solve", "lens", "--width", 1), "is not one of f, wd, sensor"),
        (("--f", 8, "--width", 1), "--solve f, wd or sensor and --width METRES"),
        ((WEBCAM, "--solve", "f", "--width", 1), "--solve f solves for --focal or the camera file"),
        ((FISHEYE, "--solve", "wd", "--width", 1), "field of view of 180° or more, no width fills the image"),
        ((WEBCAM, "--size", "640x480"), "the camera file is for 1280x720 images"),
        (("--f", 8, "--sensor", "1/2", "--board", "chessboard:9x6:25mm"), "--board needs a CAMERA file, or --focal"),
        ((WEBCAM, "--board", "chessboard:9x6"), "add the side of a square"),
        ((WEBCAM, "--board", "chessboard:9x6:25mm", "--tilt", 90), "is more than 80"),
        ((WEBCAM, "--board", "chessboard:9x6:25mm", "--share", 0), "--share must be more than 0"),
        (("--f", 8, *PIXELS, "--plot", "a.png"), "--plot needs the depth of field: give --focus and --f-number too"),
        ((*LENS, *PIXELS, "--plot", "a.jpg"), "use .png, .svg, .pdf"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_one_line(run, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("optics", *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_missing_camera_file_is_a_file_error(run, tmp_path):
    assert run("optics", tmp_path / "none.yaml")[0] == 3


def test_the_field_of_view_of_a_camera_file_ends_at_its_image_circle(run, tmp_path):
    lens = Camera(model_named("kannala_brandt4"), (640, 480), np.array([150.0, 150, 319.5, 239.5, 0, 0, 0, 0]))
    circle = ImageCircle((640, 480), (319.5, 239.5), 210.0)
    path = tmp_path / "fish.yaml"
    native.write(path, CameraFile({"fish": CameraEntry(lens, valid=ValidRegion(image_circle=circle))}))
    code, out, err = run("optics", path, "--distance", 2, "--json")
    found = json.loads(out)
    assert (code, err) == (0, "")
    np.testing.assert_allclose(list(found["field_of_view"].values()), np.degrees(420 / 150))  # of an equidistant lens
    at = found["distances"][0]
    np.testing.assert_allclose([at["width_m"], at["height_m"]], 4 * np.tan(210 / 150))
