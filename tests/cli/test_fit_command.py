"""`camcal fit`: what it says, what it writes, and its exits."""

import json

import cv2
import numpy as np
import pytest
import yaml

EXPQUAD = "exp(a*x**2 + b*x + c)"
START = "a=2,b=-1,c=5"


def write(path, **columns):
    rows = np.stack(list(columns.values()), axis=1)
    lines = [",".join(columns), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def data(tmp_path):
    """A hundred points of exp(x² + 2x + 1) with noise 1."""
    x = np.linspace(0, 1, 100)
    return write(tmp_path / "data.csv", x=x, y=np.exp(x**2 + 2 * x + 1) + np.random.default_rng(0).normal(size=100))


@pytest.fixture
def circle(tmp_path):
    angles = np.linspace(0, 2, 40)
    noise = 0.01 * np.random.default_rng(1).normal(size=(2, 40))
    return write(tmp_path / "circle.csv", u=5 + 2 * np.cos(angles) + noise[0], v=2 * np.sin(angles) - 3 + noise[1])


def document(run, *arguments):
    code, out, _ = run("fit", *arguments, "--json")
    return code, json.loads(out)


def test_values_errors_intervals_and_goodness_are_said(run, data):
    code, out, err = run("fit", data, "--model", EXPQUAD, "--start", START, "--verbose")
    assert code == 0
    assert err == ""
    for words in (EXPQUAD, "95 % from", "97 degrees of freedom", "R2 0.99", "condition 68", "best of 2 runs", "-0.984"):
        assert words in out


def test_the_json_document(run, data):
    code, found = document(run, data, "-m", EXPQUAD, "--start", START)
    assert code == 0
    assert list(found) == [
        "schema", "model", "formula", "parameters", "derived", "free", "correlation", "strong_correlations",
        "unobservable", "at_bounds", "rows", "degrees_of_freedom", "sum_of_squares", "rms", "sigma", "chi_square",
        "p_value", "r_squared", "condition", "iterations", "runs", "converged", "reason", "profile",
        "comparison",
        "jacobian_check", "outliers", "largest_leverage", "warnings",
    ]  # fmt: skip
    assert found["schema"] == "camcal/fit/1"
    assert list(found["parameters"]["a"]) == ["value", "std", "interval", "held"]
    assert abs(found["parameters"]["a"]["value"] - 1) < 3 * found["parameters"]["a"]["std"]
    assert np.shape(found["correlation"]) == (3, 3)


def test_a_family_starts_by_itself_and_may_be_given_other_columns(run, data, circle):
    code, found = document(run, data, "-m", "expquad")
    assert code == 0
    assert abs(found["parameters"]["b"]["value"] - 2) < 3 * found["parameters"]["b"]["std"]
    code, found = document(run, circle, "-m", "circle", "--x", "u,v")
    assert code == 0
    assert found["parameters"]["r"]["value"] == pytest.approx(2, abs=0.02)  # three standard errors
    assert found["derived"]["diameter"]["value"] == pytest.approx(2 * found["parameters"]["r"]["value"])
    assert found["r_squared"] is None


def test_x_stands_for_a_column_and_y_may_be_a_formula(run, tmp_path):
    time = np.linspace(0, 3, 30)
    path = write(tmp_path / "decay.csv", time=time, counts=np.exp(2 - 0.7 * time))
    code, found = document(run, path, "-m", "a - k*x", "--x", "time", "--y", "log(counts)", "--start", "a=0,k=0")
    assert code == 0
    assert found["parameters"]["k"]["value"] == pytest.approx(0.7, abs=1e-7)  # counts are written to nine digits


def test_several_columns_are_used_by_name(run, tmp_path):
    rng = np.random.default_rng(2)
    p, q = rng.normal(size=(2, 40))
    path = write(tmp_path / "plane.csv", p=p, q=q, z=3 * p - 2 * q + 1)
    code, found = document(run, path, "-m", "a*p + b*q + c", "--start", "a=0,b=0,c=0")
    assert code == 0
    assert [found["parameters"][name]["value"] for name in "abc"] == pytest.approx([3, -2, 1], abs=1e-8)


def test_sigma_is_a_number_or_a_column_and_gives_chi_square(run, tmp_path, data):
    _, one = document(run, data, "-m", "expquad", "--sigma", 1)
    table = np.loadtxt(data, delimiter=",", skiprows=1)
    path = write(tmp_path / "with.csv", x=table[:, 0], s=np.ones(100), y=table[:, 1])
    _, other = document(run, path, "-m", "expquad", "--sigma", "s")
    assert one["chi_square"] == pytest.approx(one["sum_of_squares"])
    assert 0.01 < one["p_value"] < 0.99
    assert other["parameters"] == one["parameters"]


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_the_result_is_written_as_it_is_said(run, data, tmp_path, suffix):
    path = tmp_path / f"fit{suffix}"
    code, out, _ = run("fit", data, "-m", "expquad", "-o", path)
    assert code == 0
    assert f"wrote {path}" in out
    text = path.read_text()
    written = json.loads(text) if suffix == ".json" else yaml.safe_load(text.removeprefix("%YAML 1.1\n"))
    assert written["format"] == "camcal-fit"
    assert written["data"] == "data.csv"
    _, said = document(run, data, "-m", "expquad")
    assert written["parameters"]["b"]["std"] == said["parameters"]["b"]["std"]


def test_the_same_bytes_are_written_again(run, data, tmp_path):
    for name in ("one", "two"):
        arguments = ("--plot", tmp_path / f"{name}.png", "-o", tmp_path / f"{name}.yaml", "--restarts", 2, "-q")
        assert run("fit", data, "-m", "expquad", *arguments)[0] == 0
    for suffix in (".png", ".yaml"):
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()


def test_every_iteration_can_be_seen_as_a_table_or_a_file(run, data, tmp_path):
    _, out, _ = run("fit", data, "-m", EXPQUAD, "--start", START, "--trace", "table")
    assert "run  iteration " in out
    path = tmp_path / "trace.csv"
    assert run("fit", data, "-m", EXPQUAD, "--start", START, "--trace", path, "-q")[0] == 0
    lines = path.read_text().splitlines()
    assert lines[0] == "run,iteration,cost,trial_cost,damping,gain,step,accepted"
    accepted = [line.split(",") for line in lines[1:] if line.endswith("true") and line.startswith("1,")]
    costs = [float(row[3]) for row in accepted]
    assert costs == sorted(costs, reverse=True)


@pytest.mark.parametrize(
    ("model", "arguments"),
    [
        ("expquad", ()),
        ("expquad", ("--sigma", 1, "--loss", "tukey")),
        ("circle", ()),
        ("a*u + b*v + c", ("--y", "w", "--start", "a=0,b=0,c=0")),
        ("plane", ("--x", "u,v,w")),
    ],
)
def test_the_plot_shows_points_and_curve(run, data, circle, tmp_path, model, arguments):
    path = data if model == "expquad" else circle
    if "w" in str(arguments):
        table = np.loadtxt(circle, delimiter=",", skiprows=1)
        path = write(tmp_path / "three.csv", u=table[:, 0], v=table[:, 1], w=table[:, 0] + 0.1 * table[:, 1] ** 2)
    assert run("fit", path, "-m", model, *arguments, "--plot", tmp_path / "plot.png", "-q")[0] == 0
    blue, _, red = np.moveaxis(cv2.imread(str(tmp_path / "plot.png")).astype(int), 2, 0)
    assert np.count_nonzero(blue > red + 60) > 200  # points
    assert np.count_nonzero(red > blue + 60) > 200  # the curve, and the line of no residual


def test_models_are_compared(run, data):
    code, out, _ = run("fit", data, "-m", "expquad", "--compare", "exp(b*x + c)", "--start", "b=1,c=1")
    assert code == 0
    assert "preferred: exp(a*x**2 + b*x + c)" in out
    assert "F 43" in out
    _, found = document(run, data, "-m", "expquad", "--compare", "poly:1")
    assert found["comparison"]["preferred"] == "first"
    assert found["comparison"]["with"]["model"] == "poly:1"


def test_likelihood_intervals_and_the_check_of_derivatives_are_said(run, data):
    code, out, _ = run("fit", data, "-m", EXPQUAD, "--start", START, "--profile", "--check-jacobian")
    assert code == 0
    assert "by likelihood" in out
    assert "derivatives agree with the complex step to" in out
    _, found = document(run, data, "-m", "abs(a)*x + b", "--start", "a=1,b=1", "--check-jacobian")
    assert found["jacobian_check"]["method"] == "central"
    assert found["jacobian_check"]["error"] < 1e-8


def test_outliers_are_counted_and_listed_by_line(run, tmp_path):
    x = np.linspace(0, 1, 40)
    y = 3 * x + 0.01 * np.random.default_rng(3).normal(size=40)
    y[[5, 20]] += 9
    path = write(tmp_path / "spoilt.csv", x=x, y=y)
    _, out, _ = run("fit", path, "-m", "poly:1", "--loss", "tukey")
    assert "of 40 rows with less than half weight" in out
    _, found = document(run, path, "-m", "poly:1", "--loss", "tukey")
    assert {7, 22} <= set(found["outliers"])
    assert len(found["outliers"]) < 8  # a few of the tails of 38 normal numbers among them


def test_plain_gauss_newton_fails_from_afar_and_exits_with_5(run, data):
    assert run("fit", data, "-m", EXPQUAD, "--start", START, "--method", "gauss-newton")[0] == 0
    code, _, err = run("fit", data, "-m", EXPQUAD, "--start", "a=0,b=0,c=0", "--method", "gauss-newton")
    assert code == 5
    assert "the full step raises the cost; try another --start or --restarts 5" in err


def test_a_bound_that_holds_exits_with_5_and_the_result_is_said(run, data):
    code, found = document(run, data, "-m", "expquad", "--start", "a=2", "--bounds", "a=1.2:")
    assert code == 5
    assert found["at_bounds"] == ["a"]
    assert found["parameters"]["a"] == {"value": 1.2, "std": None, "interval": None, "held": "bound"}


def test_parameters_that_cannot_be_told_apart_exit_with_4_and_are_named(run, data):
    code, out, err = run("fit", data, "-m", f"d*{EXPQUAD}", "--start", f"{START},d=2")
    assert code == 4
    assert "parameters not separable by the data: c - " in err
    assert "unobservable" in out
    assert run("fit", data, "-m", f"d*{EXPQUAD}", "--start", START, "--fix", "d=2")[0] == 0


def test_strong_correlations_are_warned_of(run, tmp_path):
    x = np.linspace(50, 51, 30)
    path = write(tmp_path / "far.csv", x=x, y=3 * x + np.random.default_rng(1).normal(size=30))
    _, _, err = run("fit", path, "-m", "poly:1")
    assert "warning: a0 and a1 are strongly correlated (r = -1.0000)" in err


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("-m", "exp(a*x) + cc", "--start", "a=1,c=2"), 2, "character 12: unknown name 'cc'"),
        (("-m", "a*x^2", "--start", "a=1"), 2, "a power is written **, not ^"),
        (("-m", "open('x')", "--start", "a=1"), 2, "unknown function 'open'"),
        (("-m", "a*log(x)", "--start", "a=1"), 2, "not a number for 1 of 100 rows, first for x=0"),
        (("-m", "a*x", "--start", "a=1,q=2"), 2, "--start q: no such parameter; possible here: a"),
        (("-m", "a*x", "--start", "a=1", "--fix", "aa"), 2, "--fix aa: no such parameter. Did you mean 'a'?"),
        (("-m", "a*x", "--start", "a=1", "--bounds", "b=0:1"), 2, "--bounds b: no such parameter"),
        (("-m", "a*x", "--start", "a=1", "--bounds", "a=0"), 2, "write NAME=LOW:HIGH"),
        (("-m", "a*x", "--start", "a=1", "--bounds", "a=1:0"), 2, "1 is not below 0"),
        (("-m", "a*x", "--start", "a=9", "--bounds", "a=0:1"), 2, "a=9 is outside its bounds 0 … 1"),
        (("-m", "a*x", "--start", "a"), 2, "write NAME=VALUE"),
        (("-m", "a*x", "--start", "=1"), 2, "write NAME=VALUE"),
        (("-m", "a*x", "--start", "a=one"), 2, "'one' is not a number"),
        (("-m", "a*x", "--start", "a=1,a=2"), 2, "'a' occurs twice"),
        (("-m", "a*x", "--start", "a=1,x=2"), 2, "it is a column"),
        (("-m", "a*x", "--start", "a=1", "--x", "z"), 2, "--x: no column 'z'"),
        (
            ("-m", "a + b*y", "--y", "x", "--x", "y", "--start", "a=1,b=1"),
            2,
            "--x given, but the model has no x; columns are used by their names",
        ),
        (("-m", "a*1e300*exp(x)", "--start", "a=1"), 2, "too large to compute with for 100 of 100 rows"),
        (("-m", "a/0", "--start", "a=1"), 2, "not a number for 100 of 100 rows, first for row 1"),
        (("-m", "a*x", "--fix", "a=2"), 2, "all parameters are fixed"),
        (("-m", "2*x"), 2, "has no parameter to fit"),
        (("-m", "a*y", "--start", "a=1"), 2, "the model contains its target 'y'"),
        (("-m", "gaus"), 2, "unknown curve 'gaus'. Did you mean 'gauss'?"),
        (("-m", "poly:99"), 2, "write poly:N"),
        (("-m", "poly:-1"), 2, "poly:-1: write poly:N"),
        (("-m", "plane"), 2, "3 columns are needed for x, y, z"),
        (("-m", "expquad", "--y", "z"), 2, "--y: no column 'z'"),
        (("-m", "expquad", "--sigma", "sgima"), 2, "--sigma: no column 'sgima'"),
        (("-m", "expquad", "--sigma", 0), 2, "sigma must be positive, found 0"),
        (("-m", "expquad", "--loss", "hubre"), 2, "'hubre' is not one of none, huber"),
        (("-m", "expquad", "--method", "newton"), 2, "'newton' is not one of"),
        (("-m", "expquad", "--loss", "huber", "--profile"), 2, "--profile needs a likelihood"),
        (("-m", "expquad", "--plot", "plot.bmp"), 2, "is not written; use .png"),
        (("-m", "expquad", "-o", "fit.txt"), 2, "is not written; use .yaml"),
        (("-m", "expquad", "--trace", "trace.txt"), 2, "is not written; use .csv"),
        (("-m", "poly:20", "--x", "y", "--y", "x", "--fix", "a0", "--start", "a99=1"), 2, "--start a99"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(run, data, arguments, code, words):
    found, out, err = run("fit", data, *arguments)
    assert (found, out) == (code, "")
    assert err.count("\n") == 1
    assert words in err


def test_a_column_called_like_a_constant_is_not_taken_for_it(run, tmp_path):
    path = write(tmp_path / "data.csv", x=np.arange(9.0), pi=np.ones(9), y=np.arange(9.0))
    for arguments in (("-m", "a*pi*x", "--start", "a=1"), ("-m", "poly:1", "--y", "y*pi")):
        code, _, err = run("fit", path, *arguments)
        assert code == 2
        assert "'pi' is both a column and the constant 3.14159" in err
    assert run("fit", path, "-m", "a*x", "--start", "a=1")[0] == 0


def test_fewer_data_than_parameters_exit_with_4(run, tmp_path):
    path = write(tmp_path / "few.csv", x=np.arange(2.0), y=np.arange(2.0))
    code, found = document(run, path, "-m", "expquad")
    assert code == 4
    assert found["error"]["message"].startswith("too few data (2 for 3 parameters)")


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("", 3, "is empty"),
        ("x,y\n", 3, "no rows of numbers"),
        ("1,2\n3,4\n", 2, "no column names"),
        ("x,x\n1,2\n", 2, "'x' occurs twice"),
        ("x;y\n1,5;2,5\n", 2, "data.csv:1: one column, 'x;y': columns are separated by commas, not semicolons"),
        ("x,y\n1,two\n", 2, "data.csv:2: y: 'two' is not a number"),
        ("x,y\n1,1e200\n", 2, "data.csv:2: y: 1e+200 exceeds the numerical range"),
        ("x,y\n1,nan\n", 2, "data.csv:2: y: nan is not finite"),
        ("x,y\n1,2,3\n", 2, "3 cells under 2 columns"),
    ],
)
def test_tables_that_are_none_are_refused_with_their_line(run, tmp_path, text, code, words):
    path = tmp_path / "data.csv"
    path.write_text(text)
    found, _, err = run("fit", path, "-m", "poly:1")
    assert found == code
    assert words in err


def test_comments_and_columns_not_used_do_not_matter(run, tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("# lamp 3\nx,note,y\n0,dark,1\n# warm\n1,lit,3\n2,lit,5.1\n")
    code, found = document(run, path, "-m", "poly:1", "--y", "y", "--x", "x")
    assert code == 0
    assert found["largest_leverage"]["line"] in {3, 6}


def test_a_settings_file_gives_the_model(run, tmp_path, data):
    settings = tmp_path / "fit_settings.yaml"
    settings.write_text("model: expquad\nloss: huber\n")
    code, out, _ = run("fit", data, "--config", settings)
    assert code == 0
    assert "exp(a*x**2 + b*x + c)" in out


def test_the_data_are_not_overwritten(run, tmp_path, data):
    path = data.with_suffix(".json")
    path.write_bytes(data.read_bytes())
    code, _, err = run("fit", path, "-m", "expquad", "-o", path)
    assert code == 2
    assert "is an input" in err
