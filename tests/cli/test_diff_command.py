"""`camcal diff` as it is called from a shell."""

import json

import numpy as np
import pytest

import camcal
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.quality.camera_comparison import CameraComparison

LENS = np.array([500.0, 500.0, 319.5, 239.5, -0.1, 0.05, 0.0, 0.0])
STDS = np.array([0.5, 0.5, 0.5, 0.5, 1e-3, 2e-3, 1e-5, 1e-5])
DISTANCE = ["distance_m", "rms_px", "compared_rms_px", "worst_px", "compared_worst_px", "std_px", "valid_share"]


def camera(size=(640, 480), known=True, **steps):
    names = model_named("opencv4").parameter_names
    lens = LENS + [steps.get(name, 0.0) for name in names]
    return Camera(model_named("opencv4"), size, lens, np.diag(STDS**2) if known else None)


def write(path, images=(), **cameras):
    used = [{"file": name, "sha256": name, "used": True} for name in images]
    entries = {name: CameraEntry(each, quality={"images_used": 20}) for name, each in cameras.items()}
    native.write(path, CameraFile(entries, provenance={"tool": "camcal", "images": used}))
    return path


@pytest.fixture
def files(tmp_path):
    return {
        "own": write(tmp_path / "own.yaml", images="ab", left=camera()),
        "again": write(tmp_path / "again.yaml", images="cd", left=camera(fx=0.4, fy=0.4)),
        "moved": write(tmp_path / "moved.yaml", left=camera(fx=5.0, fy=5.0)),
        "bare": write(tmp_path / "bare.yaml", left=camera(known=False, fx=1.0)),
        "cut": write(tmp_path / "cut.yaml", left=camera(size=(640, 360))),
        "rig": write(tmp_path / "rig.yaml", left=camera(), right=camera(cx=20.0)),
        "later": write(tmp_path / "later.yaml", left=camera(), right=camera(cx=26.0)),
    }


def test_two_cameras_are_compared_in_a_line_and_a_row(run, files):
    code, out, err = run("diff", files["own"], files["again"])
    assert (code, err) == (0, "")
    assert "again.yaml: the same camera within what is known: the difference is" in out
    assert out.splitlines()[-1].split()[1] == "infinity"
    code, out, _ = run("diff", files["own"], files["moved"])
    assert code == 0
    assert "moved.yaml: the lens moved: the difference is" in out


def test_the_document_has_its_keys(run, files):
    code, out, _ = run("diff", files["own"], files["again"], files["bare"], "--at", "0.5m,200cm", "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document) == ["schema", "first", "cameras", "outputs", "warnings"]
    assert document["schema"] == "camcal/diff/1"
    again, bare = document["cameras"]
    assert list(again) == [
        *("camera", "verdict", "reason", "focal_change", "principal_point_shift_px", "common_images", "distances"),
        *("difference", "distortion"),
    ]
    assert [list(each) for each in again["distances"]] == [DISTANCE, DISTANCE]
    assert [each["distance_m"] for each in again["distances"]] == [0.5, 2.0]
    assert list(again["difference"]) == list(again["distortion"]) == ["sigmas", "chance", "dof", "dof_below"]
    assert (again["verdict"], bare["verdict"], bare["difference"]) == ("same", "unknown", None)


def test_gates_end_with_7_and_a_line_for_each_camera_that_fails(run, files):
    cameras = [files[name] for name in ("own", "again", "moved", "bare")]
    code, _, err = run("diff", *cameras, "--max", "1", "--max-sigma", "4")
    assert code == 7
    assert [line.split(": ", 2)[-1].split(" differ")[0] for line in err.splitlines() if "moved.yaml" in line]
    assert "moved.yaml: projections differ by up to" in err
    assert "standard deviations (limit 4)" in err
    assert "no standard deviation of the difference" in err
    assert "again.yaml" not in err
    code, out, _ = run("diff", *cameras[:3], "--max", "1", "--json")
    failures = json.loads(out)["failures"]
    assert (code, [each["code"] for each in failures]) == (7, ["camera_difference"])
    assert run("diff", *cameras[:2], "--max", "1", "--max-sigma", "4")[0] == 0


def test_images_of_both_are_said(run, tmp_path, files):
    other = write(tmp_path / "other.yaml", images="bc", left=camera(fx=1.0))
    assert "both are calibrated from the same 1 image" in run("diff", files["own"], other)[1]


def test_rigs_are_compared_camera_by_camera(run, files):
    code, out, _ = run("diff", files["rig"], files["later"], "--json")
    verdicts = {each["camera"].rpartition("#")[2]: each["verdict"] for each in json.loads(out)["cameras"]}
    assert (code, verdicts) == (0, {"left": "same", "right": "moved"})
    assert run("diff", f"{files['rig']}#left", f"{files['later']}#right")[0] == 0
    code, _, err = run("diff", files["rig"], files["own"])
    assert code == 2
    assert "name one camera of each file" in err


def test_formats_of_other_programs_are_the_same_camera(run, tmp_path, files):
    assert run("convert", files["own"], tmp_path / "opencv.xml")[0] == 0
    code, out, _ = run("diff", files["own"], tmp_path / "opencv.xml", "--max", "0.01", "--max-sigma", "1")
    assert code == 0
    assert "the projections agree within 0.001 px" in out


def test_map_and_table_are_written(run, tmp_path, files):
    code, _, err = run(
        "diff",
        files["own"],
        files["moved"],
        "--at",
        "0.5m,2m",
        "--csv",
        tmp_path / "d.csv",
        "--plot",
        tmp_path / "d.png",
    )
    assert (code, err) == (0, "")
    assert (tmp_path / "d.png").read_bytes().startswith(b"\x89PNG")
    mark, head, *lines = (tmp_path / "d.csv").read_text().splitlines()
    assert mark == "# camcal diff"
    assert head == "camera,distance_m,u,v,du,dv,difference_px,std_px,sigmas,compared"
    assert len(lines) == 2 * 31 * 23
    row = dict(zip(head.split(","), lines[-1].split(","), strict=True))
    assert float(row["difference_px"]) == pytest.approx(np.hypot(float(row["du"]), float(row["dv"])), rel=1e-4)
    assert (row["distance_m"], row["u"], row["v"]) == ("2", "639", "479")
    code, _, err = run("diff", files["own"], files["moved"], files["bare"], "--plot", tmp_path / "e.png")
    assert code == 2
    assert "--plot draws one difference, and there are 2" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["own"], "give two or more to compare"),
        (["own", "cut"], "cannot be compared, because images of 640 x 480 pixels are not resized images of 640 x 360"),
        (["own", "again", "--at", "0.5in"], "is not lengths such as 0.5m,800mm"),
        (["own", "again", "--at", "0"], "is not lengths"),
    ],
)
def test_bad_input_gets_one_line(run, files, arguments, words):
    code, _, err = run("diff", *(files.get(each, each) for each in arguments))
    assert code == 2
    assert words in err
    assert len([line for line in err.splitlines() if line.startswith("camcal: error")]) == 1


def test_a_library_call_compares_files_and_cameras(files):
    found = camcal.compare_cameras(files["own"], files["moved"])
    assert isinstance(found, CameraComparison)
    assert found.verdict == camcal.compare_cameras(camera(), camera(fx=5.0, fy=5.0)).verdict == "moved"
    assert camcal.compare_cameras(files["own"], f"{files['rig']}#left", distances=[0.5]).verdict == "same"
