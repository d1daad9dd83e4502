"""AprilGrids: tags found and time beside cv2.aruco on real images, corners beside a chessboard's on rendered ones.

    CAMCAL_TEST_DATA=FOLDER python benchmarks/aprilgrid.py [--only rendered|real] [--views N]

Real: tags of which a corner is found / tags on the board, and ms on one core, decoding excluded; ArUco is
cv2.aruco.ArucoDetector with the border set to two cells and AprilTag's corners refined by contour.
Rendered: a 6 x 6 AprilGrid and a chessboard of 6 x 6 corners in the same poses, tags as far apart as the chessboard's
corners: corners found, root mean square error per axis in px of both, their ratio, and the normalised squared error of
the AprilGrid's covariance (1 is honest). gap / blur: the narrowest gap on the middle of the board, foreshortened, in
standard deviations of the blur, the pixel's own included.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from itertools import product
from pathlib import Path

import cv2
import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.images.files import gray_8bit, load
from camcal.simulate.render import Exposure, render
from camcal.simulate.scene import make_camera
from camcal.targets.board import parse_board
from camcal.targets.detect import detect

DATA = Path(os.environ.get("CAMCAL_TEST_DATA", Path(__file__).parents[2] / "shared" / "data"))
APRILGRID, CHESSBOARD = parse_board("aprilgrid:6x6:88mm:0.3"), parse_board("chessboard:6x6:114.4mm")
CAMERA = make_camera(model_named("opencv4"), (1280, 960), np.radians(70))
PITCHES, BLURS, TILTS = (100, 60, 40, 30), (0.5, 0.9, 1.6), (0.0, 0.5, 0.9)
NOISE_DN = 2.0
GAP = 0.3 / 1.3  # of the pitch


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--only", choices=("rendered", "real"))
    options = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"OpenCV {cv2.__version__}")
    if options.only != "rendered":
        real(sorted((DATA / "aprilgrid").glob("*/*.png")))
    if options.only != "real":
        rendered(options.views)


def real(images: list[Path]) -> None:
    print("\n| image | ArUco | ms | camcal | ms |\n|---|---|---|---|---|")
    for path in images:
        gray = gray_8bit(load(path).pixels)
        (read, theirs), (detection, ours) = timed(aruco, gray), timed(detect, gray, APRILGRID)
        print(f"| {path.name} | {read} | {theirs:.0f} | {len(np.unique(detection.ids // 4))} | {ours:.0f} |")


def timed(find, *arguments):
    """Return what is found and the median time of three runs in ms."""
    spent = []
    for _ in range(3):
        start = time.perf_counter()
        found = find(*arguments)
        spent.append(time.perf_counter() - start)
    return found, 1e3 * np.median(spent)


def aruco(gray: np.ndarray) -> int:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    _, ids, _ = cv2.aruco.ArucoDetector(family, parameters).detectMarkers(gray)
    return 0 if ids is None else len(np.unique(ids))


def rendered(views: int) -> None:
    print(
        "\n| pitch px | blur px | tilt rad | gap / blur | found | RMS | chessboard | ratio | NEES |\n"
        + "|---" * 9
        + "|"
    )
    for spacing, blur, tilt in product(PITCHES, BLURS, TILTS):
        tags, corners = (
            np.concatenate([errors(board, spacing, blur, tilt, view) for view in range(views)])
            for board in (APRILGRID, CHESSBOARD)
        )
        ours, theirs = (np.sqrt(np.mean(part[:, :2] ** 2)) for part in (tags, corners))
        gap = spacing * GAP * np.cos(tilt) / np.hypot(blur, np.sqrt(1 / 12))
        print(
            f"| {spacing} | {blur} | {tilt} | {gap:.1f} | {len(tags)}/{views * APRILGRID.count} | {ours:.4f} "
            f"| {theirs:.4f} | {ours / theirs:.2f} | {tags[:, 2].mean():.2f} |"
        )


def errors(board, spacing: float, blur: float, tilt: float, view: int) -> np.ndarray:
    """Return the errors x, y in px and the normalised squared error of the corners (N, 3) found in one view."""
    pose = placed(board, spacing, tilt, view)
    image = render(
        CAMERA, board, pose, rng=np.random.default_rng(view), exposure=Exposure(blur_px=blur, noise_dn=NOISE_DN)
    )
    detection = detect(image, board)
    off = detection.pixels - CAMERA.project(pose.apply(board.points())).pixels[detection.ids]
    if detection.covariance is None:
        return np.column_stack([off, np.full(len(off), np.nan)])
    return np.column_stack([off, np.einsum("ni,nij,nj->n", off, np.linalg.inv(detection.covariance), off) / 2])


def placed(board, spacing: float, tilt: float, view: int) -> Pose:
    """Return the pose of a board in the middle of the image, tilted about an axis of its own in every view."""
    axis = 2 * np.pi * view * 0.618
    lean, spin = np.array([np.cos(axis), np.sin(axis), 0.0]) * tilt, np.array([0.0, 0.0, 0.2])
    rotation = so3.exp(lean) @ so3.exp(spin) @ np.diag([1.0, board.z_sign, board.z_sign])
    middle = np.array([*board.extent, 0.0]) / 2
    return Pose(rotation, np.array([0, 0, CAMERA.value("fx") * board.spacing / spacing]) - rotation @ middle)


if __name__ == "__main__":
    main()
