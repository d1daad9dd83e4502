"""The rigs of the real test images: what was detected of a board, and the epipolar error of a calibrated rig.

Captures are matched by the numbers in the names of images. Corners are detected once, camera by camera, and kept in a
folder outside the project: camcal's, refined with the calibrated lens, and those of OpenCV's two ways to detect a
chessboard. A board that looks the same when turned may be numbered otherwise in each image: `aligned` gives the views
of a capture the same numbers, as OpenCV's functions need them.

Epipolar error of a corner that two cameras see: with rays a and b in one frame, φ their angles about the baseline and θ
those to it, f the focal length fx of a camera in px, it is (φ_a − φ_b) times the mean of f sin θ of both cameras, px:
about the distance of the corner from its epipolar line. Positions along the line, the depth, do not count.
"""

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from real_sets import DATA

from camcal.calibrate.rigs.record import Captures
from camcal.cameras.catalogue import model_named
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera
from camcal.errors import CamcalError
from camcal.formats import detections
from camcal.geometry.pose import Pose
from camcal.targets.board import Board, parse_board
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration.calibrate import calibrate as calibrate_files
from camcal.tasks.calibration.options import CalibrateOptions

CAMCAL, OPENCV, OPENCV_SB = "camcal", "opencv", "opencv-sb"
CACHE = Path(tempfile.gettempdir()) / "camcal-rig-corners"
LEAST_CORNERS = 6
LEFT_RIGHT = ("left", "right")


@dataclass(frozen=True)
class RealRig:
    """Images of a rig: their pattern, in which {camera} stands for its name, the board, the lens model.

    simultaneous: whether the cameras exposed together, by what the residuals show. baseline: as published with the
    images, m.
    """

    pattern: str
    board: str
    cameras: tuple[str, ...] = LEFT_RIGHT
    model: str = "opencv5"
    simultaneous: bool = True
    baseline: float | None = None

    @property
    def target(self) -> Board:
        return parse_board(self.board)

    @property
    def lens(self) -> CameraModel:
        return model_named(self.model)


_TRINOCULAR = "multicam/boofcv-trinocular/{camera}/*.jpg"
_ECOCHECK = "chessboard:13x9:30mm"  # the size of its squares is not known
_SOURISHG = "chessboard:9x6:24.23mm"
RIGS = {
    "bumblebee2": RealRig(
        "stereo_rig/boofcv-bumblebee2-chess/{camera}*.jpg", "chessboard:6x4:30mm", baseline=0.1200505833
    ),
    "trinocular": RealRig(_TRINOCULAR, _ECOCHECK, ("left", "middle", "right")),
    "trinocular l-m": RealRig(_TRINOCULAR, _ECOCHECK, ("left", "middle")),
    "trinocular l-r": RealRig(_TRINOCULAR, _ECOCHECK, ("left", "right")),
    "trinocular m-r": RealRig(_TRINOCULAR, _ECOCHECK, ("middle", "right")),
    "opencv": RealRig("chessboard/opencv-left-right/{camera}*.jpg", "chessboard:9x6:25mm"),
    "sourishg 1": RealRig("stereo_rig/sourishg-stereo/calib_imgs/1/{camera}*.jpg", _SOURISHG, simultaneous=False),
    "sourishg 2": RealRig("stereo_rig/sourishg-stereo/calib_imgs/2/{camera}*.jpg", _SOURISHG, simultaneous=False),
    "fisheye": RealRig(
        "fisheye/sourishg-fisheye-stereo/imgs/{camera}*.jpg", _SOURISHG, model="kannala_brandt4", simultaneous=False
    ),
}


def captures_of(name: str, corners: str = CAMCAL, cache: Path = CACHE) -> Captures:
    """Return what the cameras of a rig saw, by the numbers of images; corners: CAMCAL, OPENCV or OPENCV_SB."""
    rig = RIGS[name]
    tables = [_table(rig, camera, corners, cache) for camera in rig.cameras]
    by_number = [{_number(view.image): view for view in table.views} for table in tables]
    numbers = sorted(set().union(*by_number))
    views = tuple(
        tuple(_usable(views.get(number), camera) for views, camera in zip(by_number, rig.cameras, strict=True))
        for number in numbers
    )
    return Captures(rig.cameras, tuple(f"{number:02d}" for number in numbers), views)


def _usable(view: BoardDetection | None, camera: str) -> BoardDetection | None:
    return replace(view, camera=camera) if view is not None and len(view.ids) >= LEAST_CORNERS else None


def _number(image: str) -> int:
    return int(re.findall(r"\d+", Path(image).stem)[-1])


def _table(rig: RealRig, camera: str, corners: str, cache: Path) -> Detections:
    folder = rig.pattern.format(camera=camera).rsplit("/", 1)[0].replace("/", "_")
    path = cache / corners / f"{folder}-{camera}.csv"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        make = _detect if corners == CAMCAL else partial(_detect_by_opencv, sector_based=corners == OPENCV_SB)
        make(rig, DATA / rig.pattern.format(camera=camera), path)
    return detections.read(path)


def _detect(rig: RealRig, pattern: Path, path: Path) -> None:
    with tempfile.TemporaryDirectory() as scratch:
        options = CalibrateOptions((str(pattern),), Path(scratch) / "camera.yaml", rig.board, save_detections=path)
        try:
            calibrate_files(replace(options, model=rig.model))
        except CamcalError:
            if not path.exists():
                raise


def _detect_by_opencv(rig: RealRig, pattern: Path, path: Path, *, sector_based: bool) -> None:
    """Write the corners of findChessboardCornersSB, or of findChessboardCorners with cornerSubPix."""
    cv2.setNumThreads(1)  # the former is not repeatable with more
    board = rig.target
    size, views = (board.columns, board.rows), []
    for image in sorted(pattern.parent.glob(pattern.name), key=lambda own: _number(own.name)):
        gray = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        if sector_based:
            cv2.setRNGSeed(0)
            found, pixels = cv2.findChessboardCornersSB(gray, size)
        else:
            found, pixels = cv2.findChessboardCorners(gray, size)
            if found:
                steps = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
                pixels = cv2.cornerSubPix(gray, pixels, (_half_window(pixels, size),) * 2, (-1, -1), steps)
        if found:
            points = pixels.reshape(-1, 2).astype(float)
            views.append(BoardDetection(image.name, gray.shape[::-1], np.arange(len(points)), points))
    detections.write(path, Detections(board, tuple(views)))


def _half_window(pixels: np.ndarray, size: tuple[int, int]) -> int:
    """Return half the side of the window of cornerSubPix: the usual 11 px, less where corners are closer."""
    grid = pixels.reshape(size[1], size[0], 2)
    nearest = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
    return int(np.clip(nearest / 2, 3, 11))


def aligned(captures: Captures, board: Board) -> Captures:
    """Return captures whose views number a symmetric board in the same way.

    The first column of corners of every view of a capture is to be on the same side as in the capture's first view;
    that is right for cameras that are not turned about their axes against one another.
    """
    turns = board.symmetries()
    if len(turns) == 1:
        return captures

    def row_of(row: tuple[BoardDetection | None, ...]) -> tuple[BoardDetection | None, ...]:
        first = next((view for view in row if view is not None), None)
        return tuple(view if view is None or first is None else _turned_as(view, first, turns) for view in row)

    return replace(captures, views=tuple(row_of(row) for row in captures.views))


def _turned_as(view: BoardDetection, first: BoardDetection, turns: Sequence[np.ndarray]) -> BoardDetection:
    """Return a view with the ids by which its points are arranged most like those of the first one."""

    def misfit(turned: BoardDetection) -> float:
        common, ours, theirs = np.intersect1d(turned.ids, first.ids, return_indices=True)
        if len(common) < LEAST_CORNERS:
            return np.inf
        shapes = [own.pixels[rows] - own.pixels[rows].mean(axis=0) for own, rows in ((turned, ours), (first, theirs))]
        return float(np.linalg.norm(shapes[0] - shapes[1]))

    return min((view.renumbered(turn) for turn in turns), key=misfit)


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras by their names and their poses camera_T_first."""

    cameras: Mapping[str, Camera]
    poses: Mapping[str, Pose]


Pair = tuple[str, str]


def epipolar_errors(rig: Rig, captures: Captures) -> dict[Pair, np.ndarray]:
    """Return the epipolar errors (N,) px of the corners that two cameras saw, by pairs of cameras, NaN where a lens
    does not know a pixel.
    """
    return {
        (captures.cameras[a], captures.cameras[b]): _pair_errors(rig, captures, a, b)
        for a, b in combinations(range(len(captures.cameras)), 2)
        if captures.cameras[a] in rig.poses and captures.cameras[b] in rig.poses
    }


def _pair_errors(rig: Rig, captures: Captures, a: int, b: int) -> np.ndarray:
    pixels = [common_pixels(row[a], row[b]) for row in captures.views]
    first, second = (np.concatenate([np.zeros((0, 2)), *(pair[side] for pair in pixels)]) for side in (0, 1))
    names = captures.cameras[a], captures.cameras[b]
    b_T_a = rig.poses[names[1]] @ rig.poses[names[0]].inverse()
    rays, others = (_rays(rig.cameras[name], own) for name, own in zip(names, (first, second), strict=True))
    others = others @ b_T_a.rotation
    baseline = b_T_a.inverse().translation
    baseline = baseline / np.linalg.norm(baseline)
    off, off_other = (own - np.outer(own @ baseline, baseline) for own in (rays, others))  # of lengths sin θ
    angle = np.arctan2(np.cross(off, off_other) @ baseline, np.sum(off * off_other, axis=1))
    focal = [rig.cameras[name].value("fx") for name in names]
    scale = (focal[0] * np.linalg.norm(off, axis=1) + focal[1] * np.linalg.norm(off_other, axis=1)) / 2
    return np.asarray(angle * scale)


def _rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    return np.asarray(camera.model.unproject(camera.parameters, pixels).directions)


def common_pixels(view: BoardDetection | None, other: BoardDetection | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the pixels (N, 2) of the corners that two views share, in both."""
    if view is None or other is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    _, ours, theirs = np.intersect1d(view.ids, other.ids, return_indices=True)
    return view.pixels[ours], other.pixels[theirs]


Solver = Callable[[Captures], Rig]
