"""`camcal report`, `--report` and `camcal rerun`: what is written, what is repeated, what is said of changes."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from report_scenes import SCENES, camera_of, detections_of

from camcal.cli.main import app
from camcal.errors import InsufficientData
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.report.page.thumbnails import PHOTO, photograph
from camcal.tasks.calibration.options import CalibrateOptions
from camcal.tasks.file_options import ReportOptions
from camcal.tasks.reports import carried as carried_data
from camcal.tasks.reports.carried import options_of, settings_of
from camcal.tasks.reports.report import report

QUICK = ("--model", "opencv4", "--flat-board", "--no-free-corners")
slow = pytest.mark.slow


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder to be in, so that files have short names wherever the test runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """The page and the camera file of a calibration, by their names, whose detections are gone."""
    folder = tmp_path_factory.mktemp("calibrated")
    words = ("calibrate", "corners.csv", "-o", "camera.yaml", "--report", "report.html", *QUICK, "--quiet")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        detections.write("corners.csv", detections_of(SCENES["good"], 12))
        with pytest.raises(SystemExit) as leaving:
            app(list(words))
    assert not leaving.value.code
    return {name: (folder / name).read_bytes() for name in ("camera.yaml", "report.html")}


@pytest.fixture
def calibration(here, calibrated):
    for name, content in calibrated.items():
        Path(name).write_bytes(content)


@pytest.fixture(scope="module")
def refused(tmp_path_factory):
    """The page of detections that are too few to calibrate a camera."""
    folder = tmp_path_factory.mktemp("refused")
    detections.write(folder / "few.csv", detections_of(SCENES["good"], 2))
    with pytest.raises(InsufficientData, match="at least 3"):
        report(ReportOptions(str(folder / "few.csv"), folder / "report.html", model="opencv5"))
    return (folder / "report.html").read_bytes()


@pytest.fixture
def refusal(here, refused):
    path = Path("report.html")
    path.write_bytes(refused)
    return path


def carried(page):
    """Return what a page carries as plain data."""
    return json.loads(re.search(r'id="camcal-run">(.*?)</script>', page, flags=re.DOTALL)[1])


def changed(path, change):
    """Write a page again with a change of what it carries."""
    page = path.read_text(encoding="utf-8")
    run = carried(page)
    change(run)
    start, end = re.search(r'id="camcal-run">(.*?)</script>', page, flags=re.DOTALL).span(1)
    path.write_text(page[:start] + carried_data.run_text(run) + page[end:], encoding="utf-8")


def test_detections_without_a_calibration_get_a_report_that_says_why(here):
    detections.write("wrong.csv", detections_of(SCENES["wrong-board"], 12))
    with pytest.raises(InsufficientData, match="--board describes another board"):
        report(ReportOptions("wrong.csv", Path("report.html"), model="opencv5"))
    page = Path("report.html").read_text(encoding="utf-8")
    assert "No calibration</h2>" in page
    assert page.index("corners (") < page.index("Check columns, rows and type of the board") < page.index("Images</h2>")


def test_a_refusal_is_repeated_byte_for_byte(run, refusal):
    code, out, _ = run("rerun", refusal, "-o", "again")
    assert code == 0
    assert "Same report, byte for byte" in out
    assert Path("again/report.html").read_bytes() == refusal.read_bytes()
    assert not Path("again/camera.yaml").exists()


def test_a_rerun_names_versions_and_processors_that_differ(run, refusal):
    changed(refusal, lambda page: page["environment"].update(numpy="1.0", processor="another one"))
    code, out, _ = run("rerun", refusal, "-o", "again")
    assert code == 0
    assert "The bytes of the report differ" in out
    assert f"numpy: 1.0 in the report, {np.__version__} here" in out
    assert "processor: another one in the report" in out
    assert "All figures agree" in out


def test_a_rerun_that_ends_otherwise_is_a_failed_gate(run, refusal):
    changed(refusal, lambda page: page.update(refusal="another reason"))
    code, out, said = run("rerun", refusal, "-o", "again")
    assert code == 7
    assert "refusal: another reason in the report" in out
    assert "1 figures differ" in said


@slow
def test_a_calibration_is_repeated_byte_for_byte_with_its_camera_file(run, calibration):
    code, out, _ = run("rerun", "report.html", "-o", "again", "--json")
    assert code == 0
    assert json.loads(out) == {
        "schema": "camcal/rerun/1",
        "same_bytes": True,
        "agrees": True,
        "environment": [],
        "differences": [],
        "outputs": ["again/camera.yaml", "again/report.html"],
        "warnings": [],
    }
    assert Path("again/camera.yaml").read_bytes() == Path("camera.yaml").read_bytes()
    assert Path("again/report.html").read_bytes() == Path("report.html").read_bytes()


@slow
def test_a_figure_that_differs_is_named_with_its_size_in_standard_deviations(run, calibration):
    def move(page):
        text = page["result"]
        focal, std = (float(found) for found in re.findall(r"\bfx: ([\d.]+)", text)[:2])
        page["result"] = text.replace(f"fx: {focal!r}", f"fx: {focal + 0.5 * std!r}", 1)

    changed(Path("report.html"), move)
    code, out, said = run("rerun", "report.html", "-o", "again")
    assert code == 7
    assert re.search(r"camera\.fx: [\d.]+ in the report, [\d.]+ now \(0\.5 standard deviations\)", out)
    assert "1 figures differ by more than 1e-06 standard deviations" in said
    assert Path("again/camera.yaml").exists()


@slow
def test_a_report_of_images_is_repeated_without_them(run, here):
    assert (
        run("simulate", "chessboard:9x6:25mm", "-o", "scene", "--views", 10, "--size", "640x480", "--seed", 5)[0] == 0
    )
    words = ("--board", "scene/board.yaml", "-o", "camera.yaml", "--report", "report.html")
    assert run("calibrate", "scene/images", *words, *QUICK, "--jobs", 1)[0] == 0
    page = Path("report.html").read_text(encoding="utf-8")
    assert page.count("data-photo=") == 10
    for image in Path("scene/images").iterdir():
        image.unlink()
    code, out, _ = run("rerun", "report.html", "-o", "again")
    assert code == 0
    assert "Same report, byte for byte" in out
    assert Path("again/camera.yaml").read_bytes() == Path("camera.yaml").read_bytes()


def test_guesses_are_carried(run, here):
    detections.write("corners.csv", detections_of(SCENES["good"], 2))
    native.write(Path("first.yaml"), CameraFile({"camera": CameraEntry(camera_of(SCENES["good"]))}))
    words = ("--guess", "first.yaml", "--fix", "k2", "-o", "camera.yaml", "--report", "report.html", "--flat-board")
    assert run("calibrate", "corners.csv", *words)[0] == 4
    Path("first.yaml").unlink()
    code, out, _ = run("rerun", "report.html", "-o", "again")
    assert (code, "Same report" in out) == (0, True)
    assert carried(Path("report.html").read_text(encoding="utf-8"))["guess"][0]["name"] == "first.yaml"


@slow
def test_a_rig_is_repeated_byte_for_byte(run, here):
    left = detections_of(SCENES["good"], 10)
    views = [replace(view, camera="left", image=f"left/{view.image}") for view in left.views]
    moved = detections_of(replace(SCENES["good"], seen_from=0.06), 10)
    views += [replace(view, camera="right", image=f"right/{view.image}") for view in moved.views]
    detections.write("rig.csv", replace(left, views=tuple(views)))
    assert run("rig", "rig.csv", "-o", "rig.yaml", "--report", "report.html", *QUICK)[0] == 0
    page = Path("report.html").read_text(encoding="utf-8")
    for said in ("Baseline right_T_left", "Epipolar error by capture", "Verdicts of the cameras", "left: residuals"):
        assert said in page
    code, out, _ = run("rerun", "report.html", "-o", "again")
    assert (code, "Same report" in out) == (0, True)
    assert Path("again/rig.yaml").read_bytes() == Path("rig.yaml").read_bytes()


@slow
def test_a_camera_file_alone_shows_what_it_holds_and_how_to_get_the_rest(run, calibration):
    code, out, _ = run("report", "camera.yaml", "-o", "page.html")
    assert code == 0
    assert "Calibration is trustworthy" in out
    page = Path("page.html").read_text(encoding="utf-8")
    focal = native.read("camera.yaml").cameras["camera"].camera.value("fx")
    assert f"{focal:.2f}"[:6] in page
    assert "They need the detections: camcal report DETECTIONS" in page
    code, _, said = run("rerun", "page.html", "-o", "again")
    assert code == 3
    assert "is no report that can be run again: it carries no detections" in said


def test_the_json_document_of_a_report(run, here):
    native.write(Path("camera.yaml"), CameraFile({"camera": CameraEntry(camera_of(SCENES["good"]))}))
    code, out, _ = run("report", "camera.yaml", "-o", "report.html", "--json")
    assert code == 0
    assert json.loads(out) == {
        "schema": "camcal/report/1",
        "output": "report.html",
        "cameras": ["camera"],
        "trustworthy": None,
        "failures": [],
        "warnings": [],
    }
    assert "Unknown</h2>" in Path("report.html").read_text(encoding="utf-8")


def test_a_report_of_one_camera_of_a_rig_is_of_that_camera_alone(run, here):
    entry = CameraEntry(camera_of(SCENES["good"]))
    apart = Transform(Pose(np.eye(3), np.array([-0.1, 0.0, 0.0])))
    native.write(Path("rig.yaml"), CameraFile({"left": entry, "right": entry}, {"right_T_left": apart}))
    code, out, err = run("report", "rig.yaml#left", "-o", "report.html", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["cameras"] == ["left"]
    page = Path("report.html").read_text(encoding="utf-8")
    assert ("Camera left" in page, "Camera right" in page, "right_T_left" in page) == (True, False, False)


def test_options_of_detections_are_refused_for_a_camera_file(run, here):
    Path("camera.yaml").write_text("format: camcal-calibration\n")
    code, _, said = run("report", "camera.yaml", "-o", "report.html", "--model", "opencv4")
    assert code == 2
    assert "--model applies to detections, not to a camera file" in said


def damaged(kind, page):
    run = re.search(r'id="camcal-run">(.*?)</script>', page, flags=re.DOTALL)[1]
    table = re.search(r'id="camcal-detections">(.*?)</script>', page, flags=re.DOTALL)[1]
    return {
        "no page": "<p>no report</p>",
        "truncated": page[: page.index(run) + len(run) // 2],
        "no json": page.replace(run, "{nonsense"),
        "a list": page.replace(run, "[1]"),
        "twice": page.replace(run, run[:-1] + ',"version":1}'),
        "key": page.replace('"environment":', '"enviroment":'),
        "command": page.replace('"command":"calibrate"', '"command":"rm"'),
        "newer": page.replace('"version":1', '"version":9'),
        "option": page.replace('"options":{', '"options":{"outputs":"x",'),
        "value": page.replace('"options":{', '"options":{"max_rejected":"nan",'),
        "type": page.replace('"options":{', '"options":{"flat_board":"yes",'),
        "guess": page.replace('"options":{', '"options":{"guess":"..",').replace(
            '"guess":[]', '"guess":[{"name":"..","content":"QQ=="}]'
        ),
        "table": page.replace(table, table[: len(table) // 2]),
        "base64": page.replace(table, "ü" + table),
    }[kind]


@pytest.mark.parametrize(
    ("kind", "code", "said"),
    [
        ("no page", 3, "is no report that can be run again"),
        ("truncated", 3, "is no report that can be run again"),
        ("no json", 3, "invalid or truncated JSON"),
        ("a list", 3, "not a JSON object"),
        ("twice", 2, "duplicate key 'version'"),
        ("key", 2, "unknown key. Did you mean 'environment'?"),
        ("command", 2, "command: unknown command 'rm'"),
        ("newer", 2, "version 9 is newer than this camcal"),
        ("option", 2, "options.outputs: unknown option"),
        ("value", 2, "nan is not a number"),
        ("type", 2, "options.flat_board: 'yes' is not a value of this option"),
        ("guess", 3, "report.html: --guess: not a YAML mapping"),
        ("table", 3, "damaged: the detections"),
        ("base64", 3, "damaged: the detections cannot be unpacked"),
    ],
)
def test_damage_is_said_in_one_line_and_nothing_is_written(run, refusal, kind, code, said):
    refusal.write_text(damaged(kind, refusal.read_text(encoding="utf-8")), encoding="utf-8")
    got, out, err = run("rerun", refusal, "-o", "again")
    assert (got, out) == (code, "")
    assert said in err
    assert len(err.strip().splitlines()) == 1
    assert not Path("again/report.html").exists()


def test_detections_that_unpack_to_more_than_the_limit_are_refused(run, refusal, monkeypatch):
    monkeypatch.setattr(carried_data, "_LARGEST_TABLE", 1000)
    code, _, said = run("rerun", refusal, "-o", "again")
    assert code == 3
    assert "more than 1000 bytes of detections" in said


def test_options_are_restored_as_they_were_given():
    given = CalibrateOptions(("a b", "c"), fix=("k3", "p1"), max_rejected=0.25, image_size=(640, 480), refine=False)
    assert options_of(CalibrateOptions, settings_of(given)) == given
    assert "output" not in settings_of(replace(given, output=Path("x.yaml")))


def test_a_photograph_is_small_and_keeps_its_shape():
    uri = photograph(np.tile(np.arange(1280, dtype=np.uint8), (960, 1)))
    assert PHOTO.fullmatch(uri)
    content = carried_data.file_content(uri.partition(",")[2], "photo")
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (240, 320)
    assert len(uri) < 30_000
