"""`camcal smooth`: tables and poses, what it says of them, its files and its exits."""

import json

import cv2
import numpy as np
import pytest

from camcal.formats import trajectories
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory

SIGMA = 0.02
KNOWN = ("--q", "1,1", "--sigma", "0.01,0.01")
KEYS = [
    "schema",
    "source",
    "kind",
    "measurements",
    "missing",
    "stamps",
    "span_s",
    "model",
    "process_noise_form",
    "method",
    "robust",
    "q",
    "q_estimated",
    "sigma",
    "sigma_estimated",
    "residual_rms",
    "log_likelihood",
    "consistency",
    "nis",
    "outliers",
    "evaluation",
    "written",
    "warnings",
]


@pytest.fixture(scope="module")
def plane(tmp_path_factory):
    """A table of positions of something that moves in a plane, and the truth (K, 2): a wrong one at row 50."""
    rng = np.random.default_rng(3)
    stamps = np.arange(150) / 30
    truth = np.column_stack([np.sin(stamps), np.cos(1.3 * stamps)])
    values = truth + SIGMA * rng.normal(size=truth.shape)
    values[50] += 1.0
    rows = [f"{t:.6f},{x:.6f},{y:.6f}" for t, (x, y) in zip(stamps, values, strict=True)]
    rows[20] = f"{stamps[20]:.6f},,{values[20, 1]:.6f}"
    path = tmp_path_factory.mktemp("plane") / "positions.csv"
    path.write_text("t,x,y\n" + "\n".join(rows) + "\n")
    return path, truth


@pytest.fixture(scope="module")
def turning(tmp_path_factory):
    """A folder with measured.tum and truth.tum."""
    rng = np.random.default_rng(4)
    stamps = 1.7e9 + np.arange(120) / 30
    since = stamps - stamps[0]
    truth = Trajectory(
        "world_T_tag",
        stamps,
        so3.exp(np.outer(np.sin(since), [0.5, 1.0, -0.3])),
        np.column_stack([since, np.cos(since), np.sin(2 * since)]),
    )
    noise = rng.normal(size=(120, 6)) * [0.01] * 1
    measured = Trajectory(
        "world_T_tag", stamps, so3.exp(noise[:, 3:]) @ truth.rotations, truth.translations + noise[:, :3]
    )
    folder = tmp_path_factory.mktemp("turning")
    trajectories.write(folder / "measured.tum", measured)
    trajectories.write(folder / "truth.tum", truth)
    return folder


def read(path):
    head, *rows = path.read_text().splitlines()[1:]
    table = np.array([[cell or "nan" for cell in row.split(",")] for row in rows], float)
    return dict(zip(head.split(","), table.T, strict=True))


def test_positions_alone_give_positions_and_velocities(run, plane, tmp_path):
    path, truth = plane
    code, out, err = run("smooth", path, "-o", tmp_path / "out.csv", "--robust", "huber")
    assert (code, err) == (0, "")
    for words in (
        "299 measurements, 1 missing",
        "constant velocity",
        "the most likely",
        "Covariances consistent: mean NIS",
        "lag-1 correlation",
    ):
        assert words in out
    assert "1.667 s (x), 1.667 s (y)" in out
    assert f"wrote {tmp_path / 'out.csv'}" in out
    found = read(tmp_path / "out.csv")
    errors = np.column_stack([found["x"], found["y"]]) - truth
    assert np.sqrt(np.mean(errors**2)) < 0.6 * SIGMA
    speed = np.cos(np.arange(150) / 30)
    assert np.sqrt(np.mean((found["x_velocity"] - speed) ** 2)) < 0.15
    assert np.mean(np.abs(errors[:, 0]) < 2 * found["std_x"]) > 0.85


def test_the_textbooks_constant_velocity_in_a_plane(run, tmp_path):
    (tmp_path / "p.csv").write_text("t,x,y\n0,0,0\n1,1,2\n2,3,4\n")
    known = ("--process-noise-form", "discrete", "--q", 4, "--sigma", 1)
    assert run("smooth", tmp_path / "p.csv", *known, "-o", tmp_path / "o.csv")[0] == 0
    found = read(tmp_path / "o.csv")
    # By hand: the first two positions give x1 and v1 = x1 - x0 + a/2, where a has variance 4 and positions have 1.
    of_positions, of_acceleration = np.array([[0.0, 1.0], [-1.0, 1.0]]), np.array([0.0, 0.5])
    P = of_positions @ of_positions.T + 4 * np.outer(of_acceleration, of_acceleration)
    F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), 4 * np.array([[0.25, 0.5], [0.5, 1.0]])
    variance = (F @ P @ F.T + Q)[0, 0] + 1
    np.testing.assert_allclose(found["nis_x"][2], (3 - 2) ** 2 / variance, rtol=1e-9)  # 2 was expected of x, 4 of y
    np.testing.assert_allclose(found["nis_y"][2], 0, atol=1e-12)


def test_the_json_document_of_a_table(run, plane):
    code, out, _ = run("smooth", plane[0], "--columns", "t,x", "--q", 1, "--sigma", SIGMA, "--json")
    document = json.loads(out)
    assert code == 0
    assert list(document) == KEYS
    assert document["schema"] == "camcal/smooth/1"
    assert (document["kind"], document["measurements"], document["missing"]) == ("series", 149, 1)
    assert (document["q"], document["q_estimated"]) == ({"all": 1.0}, False)
    assert (document["sigma"], document["sigma_estimated"]) == ({"x": SIGMA}, False)
    assert 50 in [outlier["index"] for outlier in document["outliers"]]
    assert list(document["consistency"]) == [
        "innovations",
        "mean_nis",
        "interval",
        "beyond_95",
        "autocorrelation",
        "autocorrelation_limit",
        "verdict",
    ]
    nis = document["nis"]["x"]
    assert (len(nis), nis[:2], nis[20]) == (150, [None, None], None)  # two make a velocity; row 20 is empty
    assert np.mean([value for value in nis if value is not None]) == pytest.approx(document["consistency"]["mean_nis"])
    assert document["evaluation"] is None


def test_both_methods_write_the_same(run, plane, tmp_path):
    for method in ("rts", "batch"):
        code, *_ = run(
            "smooth", plane[0], "-o", tmp_path / f"{method}.csv", "--method", method, "--q", 1, "--sigma", 0.02
        )
        assert code == 0
    one, other = read(tmp_path / "rts.csv"), read(tmp_path / "batch.csv")
    for name, values in one.items():
        np.testing.assert_allclose(values, other[name], atol=1e-9)


def test_known_displacements_carry_what_was_not_measured(run, tmp_path):
    rows = ["t,x", *(f"{t},{t if t in (0, 9) else ''}" for t in range(10))]
    (tmp_path / "x.csv").write_text("\n".join(rows))
    (tmp_path / "u.csv").write_text("t,x\n" + "".join(f"{t},{3 if t == 5 else 0.75}\n" for t in range(1, 10)))
    arguments = ("--model", "rw", "--process-noise-form", "discrete", "--q", 0.01, "--sigma", 0.1, "--method", "batch")
    code, *_ = run("smooth", tmp_path / "x.csv", "--input", tmp_path / "u.csv", "-o", tmp_path / "o.csv", *arguments)
    assert code == 0
    assert np.diff(read(tmp_path / "o.csv")["x"])[4] == pytest.approx(3, abs=0.05)  # what one step's noise allows


def test_states_are_written_at_the_times_asked_for(run, plane, tmp_path):
    code, *_ = run(
        "smooth",
        plane[0],
        "--q",
        1,
        "--sigma",
        0.02,
        "--resample",
        0.1,
        "-o",
        tmp_path / "o.csv",
        "--plot",
        tmp_path / "o.png",
    )
    assert code == 0
    np.testing.assert_allclose(read(tmp_path / "o.csv")["t"], np.arange(50) * 0.1, atol=1e-9)
    assert cv2.imread(str(tmp_path / "o.png")).shape[1] > 500


def test_poses_are_smoothed_and_compared(run, turning, tmp_path):
    code, out, err = run(
        "smooth",
        turning / "measured.tum",
        "-o",
        tmp_path / "o.csv",
        "--evaluate",
        turning / "truth.tum",
        "--align",
        "none",
        "--delta",
        "0.5s",
        "--json",
    )
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert list(document) == KEYS
    assert list(document["q"]) == list(document["sigma"]) == ["translation", "rotation"]
    assert document["sigma"]["rotation"] == pytest.approx(0.01, rel=0.2)  # 3 σ over 360 numbers
    evaluation = document["evaluation"]
    assert evaluation["delta_unit"] == "s"
    for name in ("ate_m", "ate_rad", "rpe_m", "rpe_rad"):
        assert evaluation["smoothed"][name]["rmse"] < 0.7 * evaluation["measured"][name]["rmse"]
    found = trajectories.read(tmp_path / "o.csv")
    assert found.frames == "world_T_tag"
    assert found.covariances is not None
    assert found.velocities is not None


def test_poses_that_are_smoothed_already_are_said_and_not_judged(run, turning, tmp_path):
    assert run("smooth", turning / "measured.tum", "-o", tmp_path / "once.csv")[0] == 0
    document = json.loads(run("smooth", tmp_path / "once.csv", "--json")[1])
    assert [warning["code"] for warning in document["warnings"]] == ["smoothed_already"]
    assert document["consistency"]["verdict"] == "not judged"
    code, out, _ = run("smooth", tmp_path / "once.csv")
    assert code == 0
    assert out.startswith("Covariances not judged")


def test_smoothed_poses_of_a_file_without_velocities_are_told_by_having_no_noise(run, turning, tmp_path):
    assert run("smooth", turning / "measured.tum", "-o", tmp_path / "once.tum")[2] == ""
    document = json.loads(run("smooth", tmp_path / "once.tum", "--json")[1])
    assert [warning["code"] for warning in document["warnings"]] == ["smoothed_already"]
    assert document["consistency"]["verdict"] == "not judged"


def test_poses_are_said_with_their_units_and_resampled(run, turning, tmp_path):
    code, out, _ = run(
        "smooth",
        turning / "measured.tum",
        "-o",
        tmp_path / "o.yaml",
        "--format",
        "tf",
        *KNOWN,
        "--resample",
        "0.25",
        "--evaluate",
        turning / "truth.tum",
        "--plot",
        tmp_path / "o.svg",
    )
    assert code == 0
    assert "translation 1 m²/s³, rotation 1 rad²/s³" in out
    assert "absolute, mm" in out
    np.testing.assert_allclose(np.diff(trajectories.read(tmp_path / "o.yaml").stamps), 0.25, atol=1e-6)
    assert (tmp_path / "o.svg").read_text().startswith("<?xml")


def test_times_that_a_reference_repeats_are_told(run, turning, tmp_path):
    first, *rest = (turning / "truth.tum").read_text().splitlines(keepends=True)
    (tmp_path / "truth.tum").write_text("".join([first, *rest, rest[-1]]))
    code, _, err = run("smooth", turning / "measured.tum", *KNOWN, "--evaluate", tmp_path / "truth.tum")
    assert code == 0
    assert "truth.tum: 1 poses with repeated time stamps skipped" in err


def test_the_same_input_gives_the_same_bytes(run, turning, tmp_path):
    for name in ("a.json", "b.json"):
        run("smooth", turning / "measured.tum", *KNOWN, "-o", tmp_path / name)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("--model", "cs"), 2, "'cs' is not one of rw, cv, ca"),
        (("--q", "-1"), 2, "--q must be more than 0"),
        (("--q", "1,2"), 2, "--q has 2 numbers; a table has one"),
        (("--sigma", "1,2,3"), 2, "--sigma has 3 numbers"),
        (("--q", "much"), 2, "is not numbers"),
        (("--resample", "0"), 2, "--resample must be more than 0 s"),
        (("--resample", "inf"), 2, "--resample must be more than 0 s"),
        (("--resample", "1e-9"), 2, "ask for fewer"),
        (("--sigma", "1e300"), 2, "a number to compute with"),
        (("--align", "se2"), 2, "alignment 'se2'"),
        (("--delta", "1.5"), 2, "a whole number of frames"),
        (("--resample", "1", "--process-noise-form", "discrete"), 2, "--resample needs continuous"),
        (("--method", "batch", "--process-noise-form", "discrete"), 2, "rank 1"),
        (("--columns", "t,z"), 2, "no column 'z'"),
        (("-o", "out.tum"), 2, "series are written as"),
        (("--plot", "out.bmp"), 2, "is not written; use"),
        (("--evaluate", "truth.tum"), 2, "go with poses"),
        (("--delta", "far"), 2, "--delta"),
    ],
)
def test_options_that_make_no_sense_are_refused(run, plane, arguments, code, words):
    found, _, err = run("smooth", plane[0], *arguments)
    assert found == code
    assert words in err
    assert err.count("\n") == 1


def test_files_that_are_none_have_their_exits(run, turning, tmp_path):
    assert run("smooth", tmp_path / "none.tum")[0] == 3
    assert run("smooth", turning / "measured.tum", "--evaluate", tmp_path / "none.tum")[0] == 3
    assert run("smooth", turning / "measured.tum", "-o", turning / "measured.tum")[0] == 2
    code, _, err = run("smooth", turning / "measured.tum", "--columns", "t,x")
    assert (code, "go with a CSV" in err) == (2, True)
    (tmp_path / "one.csv").write_text("t,x\n0,1\n1,\n")
    code, _, err = run("smooth", tmp_path / "one.csv")
    assert code == 4
    assert "not observed: velocity of x (1 measurements, model cv needs 2" in err
    (tmp_path / "huge.csv").write_text("t,x\n0,1e300\n1,2e300\n2,1e300\n3,2e300\n")
    code, _, err = run("smooth", tmp_path / "huge.csv")
    assert (code, "huge.csv:2: a measurement of more than 1e+50" in err) == (2, True)
    still = "".join(f"{t} 0 0 {0.01 * (t % 3 + t % 5)} 0 0 0 1\n" for t in range(20))
    (tmp_path / "still.tum").write_text(still)
    code, _, err = run("smooth", tmp_path / "still.tum")
    assert (code, "too few rotations, or none with noise" in err) == (4, True)
    (tmp_path / "one.tum").write_text("0 1 2 3 0 0 0 1\n")
    code, _, err = run("smooth", tmp_path / "one.tum")
    assert code == 4
    assert "velocity of segment 0" in err
