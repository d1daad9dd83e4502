"""Sides of real printed tags in the plane of their boards, as camcal and cv2 measure them: print or camera?

    CAMCAL_TEST_DATA=FOLDER python benchmarks/tag_prints.py

The chessboard corners of a ChArUco board are crossings of edges, which neither light nor ink moves: they give camera,
pose and scale. Sides of the board's markers, put into its plane, are wrong by a share of the side where the print is
not as drawn, and by pixels where the edges are measured wrongly; views from near and far tell one from the other:
side - nominal side = share · nominal side + pixels · size of a pixel, by least squares without outliers, with standard
errors.
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np
from real_sets import DATA, LIFECAM, PHOTONVISION
from tag_edges import perimeter

from camcal.formats import native
from camcal.targets.board import parse_board
from camcal.targets.detect import detect
from camcal.targets.markers import detect_markers
from camcal.tasks.calibration.calibrate import calibrate
from camcal.tasks.calibration.options import CalibrateOptions

FAMILY, SIDE_M = "DICT_4X4_1000", 0.01905
SETS = {
    "May, 16 views": (f"{PHOTONVISION}-05-07_lifecam_1280/*.jpg", LIFECAM),
    "June, 13 views": (f"{PHOTONVISION}-06-19_lifecam_1280_Old_Pattern/*.jpg", f"{LIFECAM}:legacy"),
}
REFINED = {
    "cv2.aruco, AprilTag's corners": cv2.aruco.CORNER_REFINE_APRILTAG,
    "cv2.aruco, cornerSubPix": cv2.aruco.CORNER_REFINE_SUBPIX,
}
FAR = 0.1  # of a side that is not of this marker


def main():
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    cv2.setNumThreads(1)
    print("| print and method | markers | sides, px | share of the side, % | pixels |")
    print("|---|---|---|---|---|")
    for name, (pattern, board_text) in SETS.items():
        for method, rows in measured(pattern, board_text).items():
            excess, px = np.array(rows).T
            (share, share_error), (pixels, pixels_error) = split(excess, px)
            cells = f"{len(px)} | {px.min():.0f} to {px.max():.0f} | {share:+.2f} ± {share_error:.2f}"
            print(f"| {name}: {method} | {cells} | {pixels:+.3f} ± {pixels_error:.3f} |", flush=True)


def measured(pattern, board_text):
    """Return rows (excess of a side in sides, side in px) by the names of methods."""
    files, board = sorted(DATA.glob(pattern)), parse_board(board_text)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "camera.yaml")
        calibrate(CalibrateOptions(tuple(map(str, files)), path, board_text))
        camera = next(iter(native.read(path).cameras.values())).camera
    rows = {method: [] for method in ("camcal", *REFINED)}
    for file in files:
        gray = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        seen = detect(gray, board)
        plane = cv2.findHomography(flat(camera, seen.pixels), board.points()[seen.ids][:, :2], cv2.RANSAC, 2e-4)[0]
        markers = detect_markers(gray, FAMILY)
        for method, all_corners in {"camcal": markers.corners, **by_opencv(gray)}.items():
            for corners in all_corners:
                placed = cv2.perspectiveTransform(flat(camera, corners)[None], plane)[0]
                excess = perimeter(placed) / 4 / SIDE_M - 1
                rows[method] += [(excess, perimeter(corners) / 4)] if abs(excess) < FAR else []
    return rows


def flat(camera, pixels):
    rays = camera.model.unproject(camera.parameters, pixels).directions
    return rays[:, :2] / rays[:, 2:]


def by_opencv(gray):
    """Return corners (M, 4, 2) px by the names of cv2.aruco's refinements."""
    found = {}
    for method, refinement in REFINED.items():
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = refinement
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILY))
        corners, _, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(gray)
        found[method] = np.array(corners, float).reshape(-1, 4, 2)
    return found


def split(excess, px):
    """Return the share of the side (%) and the pixels, each with its standard error."""
    columns, kept = np.stack([np.ones_like(px), 1 / px], axis=1), np.ones(len(px), bool)
    for _ in range(6):
        best = np.linalg.lstsq(columns[kept], excess[kept], rcond=None)[0]
        off = excess - columns @ best
        kept = np.abs(off) < 3 * 1.4826 * np.median(np.abs(off))
    errors = np.sqrt(np.diag(np.linalg.inv(columns[kept].T @ columns[kept])) * off[kept].var())
    return (100 * best[0], 100 * errors[0]), (best[1], errors[1])


if __name__ == "__main__":
    main()
