"""Numbers that files may hold by their syntax and no camera, board or pose has: every command ends as documented.

CAMCAL_ABSURD: how many values every number of a camera file takes, others from number to number, by default four.
"""

import copy
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.main import get_command

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli.main import app
from camcal.formats import disparity
from camcal.images.files import save

SIZES = (1e-300, 1e-200, 1e-30, 1e30, 1e200, 1e300)
VALUES = (0.0, *SIZES, *(-size for size in SIZES))
TAKEN = int(os.environ.get("CAMCAL_ABSURD", "4"))
FEW = (0.0, 1e-300, 1e300, -1e300)
ENDINGS = {0, 2, 3, 4, 5, 7}

COMMAND = get_command(app)
IDENTITY = np.eye(3).tolist()
VARIANCES = np.diag([1e-6] * 6).tolist()
NAMES = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"]


def lens(**more: Any) -> dict[str, Any]:
    return {
        "intrinsics": {"fx": 150.0, "fy": 150.0, "cx": 79.5, "cy": 59.5},
        "distortion": {"k1": -0.1, "k2": 0.01, "p1": 1e-4, "p2": 1e-4, "k3": 0.001},
        **more,
    }


def camera(**more: Any) -> dict[str, Any]:
    known = {
        "std": dict.fromkeys(NAMES, 0.1),
        "covariance_order": NAMES,
        "covariance": np.diag([0.01] * 9).tolist(),
    }
    return {"image_size": [160, 120], "model": "opencv5", **lens(uncertainty=known), **more}


def rig() -> dict[str, Any]:
    left = camera(
        valid={
            "max_theta_deg": 35.0,
            "max_radius_px": 95.0,
            "polygon": [[5.0, 5.0], [150.0, 5.0], [150.0, 110.0]],
            "image_circle": {"centre_px": [79.0, 60.0], "radius_px": 100.0},
        },
        quality={"rms_px": 0.2, "median_px": 0.15, "max_px": 1.0, "images_used": 20, "points_used": 900},
        noise={"sigma_px": 0.1, "degrees_of_freedom": 900, "model_error_px": 0.01},
        verdict={
            "trustworthy": True,
            "region": {"limit_px": 1.0, "share": 0.9, "polygon": [[5.0, 5.0], [150.0, 5.0], [150.0, 110.0]]},
        },
        sensor={
            "pixel_pitch_um": 3.45,
            "gain_e_per_dn": 0.2,
            "read_noise_e": 2.0,
            "full_well_e": 10000.0,
            "black_level_dn": 64.0,
            "bits": 12,
        },
        channels={"red": lens()},
    )
    left["uncertainty"]["projection"] = [{"range_m": 1.0, "centre_px": 0.1, "rms_px": 0.2, "max_px": 0.5}]
    data = {
        "format": "camcal-calibration",
        "version": 1,
        "cameras": {"left": left, "right": {"image_size": [160, 120], "model": "opencv5", **lens()}},
        "transforms": {"right_T_left": {"R": IDENTITY, "t": [-0.1, 0.0, 0.0], "covariance": VARIANCES}},
        "joint_covariance": {
            "std": {"left.fx": 0.1, "right_T_left.tx": 0.001},
            "covariance_order": ["left.fx", "right_T_left.tx"],
            "covariance": [[0.01, 0.0], [0.0, 1e-6]],
        },
        "board_shape": {
            "board": {"type": "chessboard", "inner_corners": [3, 2], "square_mm": 25.0},
            "classes": {"bow": {"scale": 0.0004, "std": 0.0001}},
            "coefficients": {"stretch": -0.003},
            "uncertainty": {"std": {"stretch": 0.001}, "covariance_order": ["stretch"], "covariance": [[1e-6]]},
            "deflection_m": 0.0003,
            "deflection_std_m": 0.0001,
            "offsets": [[0.0, 0.0, 1e-5]] * 6,
        },
        "converted_from": {"file": "a.yaml", "format": "ros", "refit_rms_px": 0.1, "refit_max_px": 0.2},
    }
    return dict(json.loads(json.dumps(data)))  # no list twice, which YAML would write as an alias


def numbers_in(data: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield where numbers stand in data, of several that are alike in a list only the first."""
    if isinstance(data, dict):
        for key, item in data.items():
            yield from numbers_in(item, (*place, key))
    elif isinstance(data, list):
        for index, item in enumerate(data[:1]):
            yield from numbers_in(item, (*place, index))
    elif isinstance(data, (int, float)) and not isinstance(data, bool):
        yield place


def block_of(place: tuple[Any, ...]) -> str:
    """Return the part of a camera file that a number stands in: a block of the left camera, or what else it holds."""
    if place[0] != "cameras":
        return str(place[0])
    return str(place[2] if place[1] == "left" else place[1])


def changed(data: Any, place: tuple[Any, ...], value: float) -> Any:
    made = copy.deepcopy(data)
    inside = made
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = value
    return made


CAMERA_COMMANDS = (
    "inspect {file}",
    "optics {file}#left",
    "convert {file}#left {out}.xml",
    "convert {file} {out}.yaml --to kalibr --max-error 1",
    "undistort {file}#left image.png -o {out}_straight -j 1",
    "undistort {file}#left --points points.csv -o {out}.csv",
    "pnp {file}#left --points seen.csv -o {out}_poses.yaml",
    "stereo rectify {file} left.png right.png -o {out}_rectified -j 1",
    "transform check {file}",
    "report {file} -o {out}.html",
    "simulate chessboard:5x4:20mm {file}#left -o {out}_made --views 1 -j 1",
)
BOARDS: tuple[dict[str, Any], ...] = (
    {"type": "chessboard", "inner_corners": [9, 6], "square_mm": 25.0},
    {"type": "charuco", "squares": [9, 7], "square_mm": 30.0, "marker_mm": 22.0, "dictionary": "DICT_5X5_100"},
    {"type": "charuco", "squares": [9, 7], "square_m": 0.03, "marker_ratio": 0.7, "dictionary": "DICT_5X5_100"},
    {"type": "aprilgrid", "tags": [6, 6], "tag_mm": 30.0, "spacing_ratio": 0.3, "family": "tag36h11"},
    {"type": "circles", "circles": [10, 8], "pitch_mm": 20.0, "diameter_mm": 8.0},
)
BOARD_COMMANDS = ("detect image.png -b {file} -o {out}.csv -j 1", "board {file} -o {out}.svg")
POSE_COMMANDS = ("transform check {file}", "smooth {file} -o {out}.csv --fps 10")
TRAJECTORY_COMMANDS = ("smooth {file} -o {out}.csv --method rts", "transform check {file}")
TRAJECTORY = [[float(number), 0.1 * number, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0] for number in range(12)]


@pytest.fixture
def lab(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    image = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((10, 10))).astype(np.uint8) * 160 + 40
    for name in ("image", "left", "right"):
        save(tmp_path / f"{name}.png", image)
    disparity.write(tmp_path / "flat.pfm", np.full((120, 160), 8.0, np.float32))
    (tmp_path / "points.csv").write_text("u,v\n10,20\n")
    object_points = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0.1, 0.1, 0), (0.05, 0.02, 0.03), (0.02, 0.07, 0.05)]
    own = Camera(model_named("opencv5"), (160, 120), np.array([150.0, 150, 79.5, 59.5, -0.1, 0.01, 1e-4, 1e-4, 0.001]))
    pixels = own.project(np.array(object_points) + np.array([0, 0, 0.5])).pixels
    rows = [f"{x},{y},{z},{u},{v}" for (x, y, z), (u, v) in zip(object_points, pixels, strict=True)]
    (tmp_path / "seen.csv").write_text("\n".join(["X,Y,Z,u,v", *rows, ""]))
    return tmp_path


def written(path: str, data: Any) -> str:
    Path(path).write_text(yaml.dump(data, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False))
    return path


@pytest.fixture
def run(capsys):
    """A function that runs a command line and gives its exit code, stdout and stderr."""

    def call(*arguments):
        with pytest.raises(SystemExit) as leaving:
            COMMAND([*arguments])
        printed = capsys.readouterr()
        return int(leaving.value.code or 0), printed.out, printed.err

    return call


def end_of(run: Any, command: str, file: str) -> tuple[int, str]:
    """Run a command; return its exit code and what it said, after holding it against what every command promises."""
    code, out, err = run(*command.format(file=file, out="made").split())
    assert code in ENDINGS, (command, code, err)
    assert "Traceback" not in err, (command, err)
    assert "Warning:" not in err, (command, err)
    return code, out + err


def rotated(items: Any, start: int, count: int) -> list[Any]:
    """Return as many items, all at most, from a start that goes round."""
    return [items[(start + number) % len(items)] for number in range(min(count, len(items)))]


def sweep(
    run: Any, name: str, data: Any, values: Any, commands: Any, *, places: Any = None, sampled: bool = False
) -> None:
    """Put values into every number of a file: it is refused with its line, or all commands that read it work.

    sampled: the first command meets TAKEN values of every number, others from number to number; so many of the others
    meet the number with one of the values that the first one takes.
    """
    for start, place in enumerate(list(numbers_in(data)) if places is None else places):
        taken = []
        for value in rotated(values, TAKEN * start, TAKEN) if sampled else values:
            code, said = end_of(run, commands[0], written(name, changed(data, place, value)))
            if code == 2:
                assert f"{name}:" in said, (place, value, said)
            else:
                taken.append(value)
        others = rotated(commands[1:], TAKEN * start, TAKEN) if sampled else commands[1:]
        for number, command in enumerate(others if taken else ()):
            for value in [taken[(start + number) % len(taken)]] if sampled else taken:
                end_of(run, command, written(name, changed(data, place, value)))


@pytest.mark.parametrize("name", ["p1", "p2"])
def test_a_crop_without_extent_is_refused(run, lab, name):
    written("rig.yaml", changed(rig(), ("cameras", "left", "distortion", name), 1e12))
    code, said = end_of(run, CAMERA_COMMANDS[4], "rig.yaml")
    assert (code, "no crop of 160x120 without an empty pixel was found" in said) == (2, True), said


SOME = [
    ("cameras", "left", "image_size", 0),
    ("cameras", "left", "intrinsics", "cx"),
    ("cameras", "left", "distortion", "k1"),
    ("cameras", "left", "uncertainty", "std", "fx"),
    ("cameras", "left", "sensor", "pixel_pitch_um"),
    ("transforms", "right_T_left", "t", 0),
]


@pytest.mark.parametrize("place", SOME, ids=lambda place: place[-2])
def test_an_absurd_number_of_a_camera_file_is_refused_or_does_no_harm(run, lab, place):
    sweep(run, "rig.yaml", rig(), (1e-300, 1e300), CAMERA_COMMANDS[:1], places=[place])


@pytest.mark.slow
@pytest.mark.parametrize("block", dict.fromkeys(map(block_of, numbers_in(rig()))))
def test_no_number_of_a_camera_file_is_too_absurd(run, lab, block):
    places = [place for place in numbers_in(rig()) if block_of(place) == block]
    sweep(run, "rig.yaml", rig(), VALUES, CAMERA_COMMANDS, places=places, sampled=True)


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board["type"])
def test_no_number_of_a_board_file_is_too_absurd(run, lab, board):
    sweep(run, "board.yaml", board, FEW, BOARD_COMMANDS)


def test_no_number_of_a_pose_file_is_too_absurd(run, lab):
    assert end_of(run, "pnp {file}#left --points seen.csv -o poses.yaml", written("rig.yaml", rig()))[0] == 0
    good = yaml.safe_load(Path("poses.yaml").read_text())
    sweep(run, "changed.yaml", good, FEW, POSE_COMMANDS)


@pytest.mark.parametrize("column", range(8))
def test_no_number_of_a_trajectory_is_too_absurd(run, lab, column):
    for value in VALUES:
        rows = copy.deepcopy(TRAJECTORY)
        rows[5][column] = value
        Path("path.tum").write_text("".join(" ".join(f"{number:.12g}" for number in row) + "\n" for row in rows))
        code, said = end_of(run, TRAJECTORY_COMMANDS[0], "path.tum")
        assert code != 2 or "path.tum:6" in said, (value, said)
