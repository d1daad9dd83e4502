"""What tests of batches have in common: a folder that every command over many items finds something to do in."""

import shutil
from pathlib import Path

import numpy as np
from room_scene import BESIDE, RoomRig

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.images.files import save

BOARD = "chessboard:6x5:25mm"
RIG = "rig/rig.yaml"
SIMULATION = ("simulate", BOARD, "cameras.yaml", "-o", "views", "--views", 8, "--jobs", 1)
COMMANDS = {
    "undistort": ("undistort", f"{RIG}#left", "images", "-o", "out", "--mask"),
    "demosaic": ("demosaic", "mosaics", "-o", "out", "--pattern", "RGGB", "--trust-pattern"),
    "stereo rectify": ("stereo", "rectify", RIG, "left", "right", "-o", "out", "--maps"),
    "stereo disparity": ("stereo", "disparity", "left", "right", RIG, "-o", "out", "--quality", "fast", "--vis"),
    "stereo cloud": ("stereo", "cloud", "left", "right", RIG, "-o", "out", "--quality", "fast"),
    "stereo run": ("stereo", "run", RIG, "left", "right", "-o", "out", "--quality", "fast"),
    "detect": ("detect", "views/images/left", "--board", BOARD, "-o", "out/corners.csv", "--draw", "out/drawn"),
    "calibrate": ("calibrate", "views/images/left", "--board", BOARD, "-o", "out/camera.yaml", "--model", "opencv4"),
    "pnp": ("pnp", "views/truth.yaml#left", "views/images/left", "--board", BOARD, "-o", "out/poses.yaml"),
    "rig": ("rig", "views/images", "--recursive", "--board", BOARD, "-o", "out/rig.yaml", "--model", "opencv4"),
}


def draw_scene(folder: Path) -> None:
    """Write images, mosaics, unrectified pairs and their rig, and the cameras of SIMULATION, which renders a board."""
    rng = np.random.default_rng(4)
    for number in range(12):
        save(folder / "images" / f"{number}.png", rng.integers(0, 255, (120, 160), np.uint8))
        save(folder / "mosaics" / f"{number}.pgm", rng.integers(0, 65000, (96, 128)).astype(np.uint16))
    (folder / "rig").mkdir()
    rig = RoomRig(folder / "rig", "pinhole", BESIDE)
    for side in ("left", "right"):
        (folder / side).mkdir()
        for number in range(3):
            shutil.copy(getattr(rig, side), folder / side / f"{number}.png")
    _write_cameras(folder / "cameras.yaml")


def _write_cameras(path: Path) -> None:
    """Write the file of two cameras that see a board together."""
    cameras = [Camera(model_named("opencv4"), (320, 240), [280 + k, 281, 159, 119, -0.1, 0, 0, 0]) for k in range(2)]
    transform = Transform(Pose.from_vector(np.array([0.02, -0.05, 0.01]), np.array([-0.06, 0.002, 0.001])))
    entries = dict(zip(("left", "right"), map(CameraEntry, cameras), strict=True))
    native.write(path, CameraFile(entries, transforms={"right_T_left": transform}))


def recorded(folder: Path = Path("out")) -> int:
    """Return how many items of a folder of outputs are recorded as complete."""
    made = folder / ".camcal-output"
    return made.read_bytes().count(b'{"files"') if made.exists() else 0


def contents(folder: Path = Path("out")) -> dict[str, bytes]:
    """Return the files of a folder and of those below it by their paths in it."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}
