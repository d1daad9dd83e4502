"""What every command prints on a terminal of 80 and of 120 columns: nothing is wider, and no number and no word broken.

Each command runs once; the tables and lines that it printed are then laid out again at every width.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from tagged import facing, photograph

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli import show
from camcal.cli.main import COMMANDS
from camcal.formats import detections, disparity, native
from camcal.formats.camera_file import CalibrationVerdict, CameraEntry, CameraFile, Transform
from camcal.formats.pose_text import Form
from camcal.geometry.pose import Pose
from camcal.images.files import save
from camcal.report.table import cells, table_lines, wrapped
from camcal.simulate.options import Sensor
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections
from camcal.tasks.simulation.options import RawOptions, SimulateOptions
from camcal.tasks.simulation.simulate import simulate

WIDTHS = (80, 120)
LONG = (
    "写真_of-the-calibration-session-in-the-large-hall-with-the-new-lens-on-the-left-front-camera-number-"  # 100 cells
)
LENS = Camera(model_named("pinhole"), (160, 120), np.array([150.0, 150.0, 79.5, 59.5]))
BOARD = Board("chessboard", 5, 4, 0.04)
WIDE = Camera(model_named("opencv5"), (1280, 960), np.array([900.0, 900, 640, 480, -0.1, 0.02, 0, 0, 0]))
SPREAD = np.diag(np.array([1e6, 1e-3, 1e-12, 40.0, 1e-9, 1e-30, 1e-9, 1e-9, 0.0]) ** 2)  # huge, tiny and none

RUNS = {
    "demo": "demo -o demo --views 12 -j 1",
    "simulate": "simulate --raw RGGB --flats 6 --darks 4 --size 96x72 chessboard:5x4:20mm -o made --views 1 -j 1",
    "simulate --stereo": "simulate --stereo -o pairs --size 160x120 -j 1",
    "board": "board aprilgrid:4x3:40mm:0.3 -o board.svg --kalibr kalibr.yaml",
    "detect": "detect boards tags/b --board chessboard:5x5:40mm -o corners.csv --draw drawn -j 1",
    "report": "report pair.yaml -o report.html",
    "rerun": "rerun again.html -o again",
    "plot": "plot path.tum -o plotted",
    "check": "check rig.yaml#camera_1 seen.csv",
    "handeye": "handeye rig.yaml#camera_1 seen.csv --robot robot.csv -o hand.yaml",
    "diff": "diff pair.yaml#left pair.yaml#right",
    "advise": "advise seen.csv -o advised.png",
    "convert": "convert pair.yaml converted.yml --to opencv",
    "calibrate": "calibrate seen.csv -o camera.yaml -j 1",
    "rig": "rig two.csv --model opencv4 --flat-board --no-free-corners -o two.yaml",
    "undistort": "undistort pair.yaml#left tags/a -o straight --mask -j 1",
    "undistort --points": "undistort pair.yaml#left --points points.csv -o straight.csv",
    "inspect": "inspect rig.yaml",
    "inspect --at": "inspect rig.yaml --at 0.8m,12m --length 100mm",
    "run": "run pipeline.yaml -j 1",
    "run --dry-run": "run pipeline.yaml -j 1 --dry-run",
    "inspect a raw frame": "inspect mosaic.png --pattern RGGB",
    "inspect a dump": "inspect dump.raw",
    "demosaic": "demosaic mosaics --pattern RGGB -o developed --trust-pattern -j 1",
    "sensor": "sensor raw/flats --dark raw/darks --pattern RGGB -o sensor.yaml --plot sensor.png -j 1",
    "stereo calibrate": "stereo calibrate two.csv two.csv --model opencv4 --flat-board --no-free-corners -o both.yaml",
    "stereo rectify": "stereo rectify pair.yaml left right -o rows --maps --opencv --ros -j 1",
    "stereo run": "stereo run pair.yaml left right -o run --quality fast -j 1",
    "stereo check": "stereo check left right -j 1",
    "stereo disparity": "stereo disparity left right pair.yaml -o maps --range 0:16 --quality fast -j 1",
    "stereo cloud": "stereo cloud flat pair.yaml -o clouds -j 1",
    "stereo eval": "stereo eval flat.pfm flat.pfm pair.yaml --gate bad2=10",
    "view": "view flat.pfm -o flat.png",
    "pnp": "pnp pair.yaml#left tags/a --tags tag36h11:50mm --all-solutions -o poses.yaml --draw looked-at -j 1",
    "track": "track pair.yaml#left tags/a --tags tag36h11:50mm --fps 10 -o track.csv -j 1",
    "smooth": "smooth series.csv -o smoothed.csv",
    "smooth --evaluate": "smooth path.tum --evaluate path.tum --align none --q 1,1 --sigma 0.01,0.01 -o smoothed.tum",
    "fit": "fit fit.csv --model a*exp(b*x)+c --start a=2,b=-1,c=0 --profile --compare a*x+b --trace table -o fit.yaml",
    "transform chain": "transform chain frames.yaml --from c --to a",
    "transform eval": "transform eval a_T_b*b_T_c --frames frames.yaml",
    "transform compose": "transform compose pose.txt pose.txt --as matrix",
    "transform invert": "transform invert frames.yaml -o inverted.yaml",
    "transform convert": "transform convert pose.txt --as dual-quat",
    "transform average": f"transform average pose.txt {LONG}.txt pose.txt",
    "transform check": f"transform check pose.txt {LONG}.txt frames.yaml",
    "transform points": "transform points xyz.csv --with pose.txt -o moved.csv",
    "optics": "optics --f 8 --sensor 1/1.8 --size 2048x1536 --N 2.8 --focus 0.5 --speed 1 --exposure 5 --baseline 0.1 "
    f"--distance {','.join(map(str, range(1, 30)))} --board chessboard:9x6:25mm",
    "optics --formats": "optics --formats",
    "doctor": "doctor",
}
SLOW = ("demo", "rerun")


@dataclass
class Shown:
    """What was laid out: tables by their columns and rows, and lines."""

    tables: list = field(default_factory=list)
    lines: list = field(default_factory=list)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a little of everything, among it files with names of 100 cells, two of them alike."""
    folder = tmp_path_factory.mktemp("samples")
    _images(folder)
    flat = np.full((120, 160), 8.0, np.float32)
    for name in ("flat", f"flat/{LONG}0", f"flat/{LONG}1"):
        disparity.write(folder / f"{name}.pfm", flat)
    entry = CameraEntry(
        LENS, verdict=CalibrationVerdict(False, ("the focal length is known to 3.1 % only", "2 views are few"))
    )
    pair = {"right_T_left": Transform(Pose(np.eye(3), np.array([-0.1, 0.0, 0.0])))}
    native.write(folder / "pair.yaml", CameraFile({"left": entry, "right": entry}, pair))
    many = CameraEntry(Camera(WIDE.model, WIDE.image_size, WIDE.parameters, SPREAD, ("k3",)))
    native.write(folder / "rig.yaml", CameraFile({f"camera_{number}": many for number in range(12)}))
    rng = np.random.default_rng(3)
    poses = views(WIDE, BOARD, 8, rng=rng)
    detections.write(folder / "seen.csv", observe(WIDE, BOARD, poses, rng=rng, noise_px=0.1)[0])
    robot = ["# x y z qx qy qz qw", *(" ".join(map(str, Form("ros").numbers(pose.inverse()))) for pose in poses)]
    (folder / "robot.csv").write_text("\n".join(robot), encoding="utf-8")
    _pair_of_views(folder, rng)
    _tables(folder, rng)
    raw = RawOptions("RGGB", Sensor(0.25, 4.0, 15000.0, 64.0, 12), flats=6, darks=4)
    simulate(SimulateOptions(folder / "raw", "chessboard:5x4:20mm", size=(96, 72), views=1, jobs=1, raw=raw))
    return folder


def _pair_of_views(folder, rng):
    poses, moved = views(WIDE, BOARD, 8, rng=rng), Pose(np.eye(3), np.array([-0.02, 0.0, 0.0]))
    placed = {"left": poses, "right": [moved @ pose for pose in poses]}
    found = [
        replace(view, camera=name, image=f"{name}/{LONG}{index}.png")
        for name, own in placed.items()
        for index, view in enumerate(observe(WIDE, BOARD, own, rng=rng, noise_px=0.1)[0])
    ]
    detections.write(folder / "two.csv", Detections(BOARD, tuple(found)))


def _images(folder):
    for number in range(3):
        tag = photograph(LENS, [(0, facing(0.001 * number, 0.0, 0.25))])
        save(folder / "tags" / "a" / f"{LONG}{number}.png", tag)
        save(folder / "tags" / "b" / f"{LONG}{number}.png", tag)
        for side in ("left", "right"):
            save(folder / side / f"{LONG}{number}.png", tag)
    mosaic = np.random.default_rng(1).integers(64, 4095, (72, 96)).astype(np.uint16)
    for name in ("mosaic", f"mosaics/{LONG}0", f"mosaics/{LONG}1"):
        save(folder / f"{name}.png", mosaic)
    (folder / "dump.raw").write_bytes(bytes(640 * 480 * 2))
    y, x = np.mgrid[:120, :160]
    squares = np.where((x // 20 + y // 20) % 2 & (abs(x - 79.5) < 60) & (abs(y - 59.5) < 50), 30, 220)
    save(folder / "boards" / f"{LONG}0.png", np.roll(squares, 10, axis=0).astype(np.uint8))


def _tables(folder, rng):
    noise = rng.normal(size=(60, 2)) * 0.02
    texts = {
        "points.csv": "u,v\n10,20\n",
        "xyz.csv": "x,y,z\n1,2,3\n",
        "series.csv": "t,x\n" + "".join(f"{k / 10},{k + noise[k, 0]}\n" for k in range(60)),
        "fit.csv": "x,y\n" + "".join(f"{k / 10},{2.5 * np.exp(-k / 30) + noise[k, 0]}\n" for k in range(60)),
        "path.tum": "# frames: w_T_c\n" + "".join(f"{k / 10} {k / 100 + noise[k, 0]} 0 1 0 0 0 1\n" for k in range(60)),
        "frames.yaml": "transforms:\n  a_T_b: {t: [0.1, 0.2, 1.0e-7], rotation_vector_deg: [10, 0, 20], "
        "std: [1.0e-5, 1.0e-4, 3.0e-9, 1, 1, 2]}\n  b_T_c: {rotation_vector_deg: [0, 9, 0], t: [0, 0, 12345.5]}\n",
        "pipeline.yaml": "steps:\n  copy: {command: convert, arguments: [pair.yaml, out/copied.xml]}\n"
        f"  {'a-long-name-' * 6}: {{command: transform check, arguments: {LONG}.txt}}\n",
        "pose.txt": "0.8 -0.6 0 0.123456789012\n0.6 0.8 0 1e-9\n0 0 1 123456.789\n0 0 0 1\n",
        f"{LONG}.txt": "0.8 -0.6 0 0.13\n0.6 0.8 0 0.001\n0 0 1 123456.8\n0 0 0 1\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


@pytest.fixture
def terminal(folder, monkeypatch):
    """A terminal of 80 columns in the folder of samples; what is laid out for it."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    shown = Shown()

    def kept_table(columns, rows, width, *, in_full=False):
        shown.tables.append((columns, rows))
        return table_lines(columns, rows, width, in_full=in_full)

    def kept_line(line, width):
        shown.lines.append(line)
        return wrapped(line, width)

    monkeypatch.setattr(show, "table_lines", kept_table)
    monkeypatch.setattr(show, "wrapped", kept_line)
    return shown


def test_every_command_has_its_runs():
    assert {entry.name for entry in COMMANDS if entry.function} <= set(RUNS)


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in RUNS])
def test_nothing_is_wider_than_the_terminal_and_nothing_is_broken(run, terminal, name, monkeypatch):
    if name == "rerun":
        run("report", "seen.csv", "-o", "again.html", "--quiet")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    code, out, err = run(*RUNS[name].split(), "--verbose")
    assert code in (0, 4, 6, 7), err
    lines = [plain(line) for line in out.splitlines()]
    assert lines, err
    fit(lines, 80)
    assert sum(line.startswith("wrote ") for line in lines) == (name == "convert" or " -o " in RUNS[name])
    assert terminal.tables or terminal.lines
    for width in WIDTHS:
        for columns, rows in terminal.tables:
            for in_full in (False, True):
                whole(columns, rows, width, in_full)
        for line in terminal.lines:
            parts = wrapped(line, width)
            fit(parts, width)
            assert " ".join(parts).split() == line.split()


def plain(line):
    """A line without what makes it bold and coloured."""
    for code in ("\x1b[1;32m", "\x1b[1;31m", "\x1b[0m"):
        line = line.replace(code, "")
    return line


def fit(lines, width):
    """Lines are not wider than the terminal, but for a word that is so itself."""
    assert [line for line in lines if cells(line) > width and len(line.split()) > 1] == []


def whole(columns, rows, width, in_full):
    """A table fits, and whatever it shows stands in its cells as it is, but for names of files that are too long."""
    lines = table_lines(columns, rows, width, in_full=in_full)
    fit(lines, width)
    said = [line for line in lines if "not shown: " in line]
    table = lines[: lines.index(said[0])] if said else lines
    tables = table_lines(columns, rows, 10_000, in_full=in_full)
    known = set(" ".join(tables).split())
    assert [word for line in table for word in line.split() if word not in known and "…" not in word] == []
    if in_full:
        assert set(" ".join(table).split()) == known
        assert not said
