"""Centres of circles: camcal and cv2.findCirclesGrid on the same rendered boards.

    python benchmarks/circles.py [--boards 6]

A 10 x 8 grid of pitch 25 mm and diameter 15 mm before a camera of 1280 x 960 pixels and f = 1000 px, turned about a
random axis. For both: boards found, RMS of a coordinate's error from the projected centres in 1/1000 px, what is left
of the eccentricity (the distance from a disc's projected centre to its ellipse's centre: 1 is all of it), and the
median processor time. For camcal besides: the normalised squared error of its covariance (1 is honest). OpenCV is asked
plainly and with clustering, and again with the image inverted where it finds nothing; its time is that of all of these.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, render
from camcal.targets.board import ASYMMETRIC_CIRCLES, Board, parse_board
from camcal.targets.circles import find_circles

SIZE, FOCAL = (1280, 960), 1000.0
PLAIN = parse_board("circles:10x8:25mm:15mm")
STAGGERED = parse_board("asymmetric_circles:4x11:20mm:15mm")
UNKNOWN = replace(PLAIN, diameter=None)


@dataclass(frozen=True)
class Scene:
    """How a board is seen: spacing of its circles in the image's middle, tilt, exposure, distortion k1."""

    title: str
    tilt_deg: float = 30.0
    spacing_px: float = 40.0
    blur_px: float = 0.7
    noise_dn: float = 2.0
    distortion: float = 0.0
    gamma: float = 1.0
    board: Board = PLAIN
    told: Board | None = None

    @property
    def exposure(self) -> Exposure:
        return Exposure(blur_px=self.blur_px, noise_dn=self.noise_dn, gamma=self.gamma)


SCENES = (
    *(Scene(f"tilt {tilt}°", tilt_deg=tilt) for tilt in (0, 20, 45, 60, 65)),
    *(Scene(f"tilt {tilt}°, spacing 60 px", tilt_deg=tilt, spacing_px=60) for tilt in (30, 45)),
    *(Scene(f"blur {blur} px", blur_px=blur) for blur in (0.5, 1.5, 2.5)),
    *(Scene(f"noise {noise}", noise_dn=noise) for noise in (1, 4, 8)),
    *(Scene(f"spacing {spacing} px", spacing_px=spacing) for spacing in (12, 20, 80)),
    Scene("spacing 12 px, blur 1.5 px", spacing_px=12, blur_px=1.5),
    Scene("spacing 20 px, blur 2.5 px", spacing_px=20, blur_px=2.5),
    *(Scene(f"tilt 45°, k1 = {k1}", tilt_deg=45, distortion=k1) for k1 in (-0.3, 0.2)),
    Scene("tilt 45°, gamma 2.2", tilt_deg=45, gamma=2.2),
    Scene("tilt 45°, diameter not told", tilt_deg=45, told=UNKNOWN),
    Scene("tilt 45°, gamma 2.2, diameter not told", tilt_deg=45, gamma=2.2, told=UNKNOWN),
    Scene("asymmetric 4 x 11, tilt 45°", tilt_deg=45, spacing_px=30, board=STAGGERED),
)


@dataclass
class Score:
    """What one finder did on one kind of scene, added up."""

    found: int = 0
    errors: list[np.ndarray] = field(default_factory=list)
    offsets: list[np.ndarray] = field(default_factory=list)
    squared: list[np.ndarray] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, pixels, covariance, truth, offset):
        """Count pixels (N, 2); each belongs to the nearest true centre, whatever the order."""
        nearest = np.linalg.norm(pixels[:, None] - truth, axis=2).argmin(axis=1)
        error = pixels - truth[nearest]
        self.found += 1
        self.errors.append(error)
        self.offsets.append(offset[nearest])
        if covariance is not None:
            self.squared.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 2)

    def cells(self, boards):
        time_ms = f"{1e3 * np.median(self.seconds):.0f}"
        if not self.found:
            return [f"0/{boards}", "", "", time_ms]
        errors, offsets = np.concatenate(self.errors), np.concatenate(self.offsets)
        size = (offsets**2).sum()
        left = f"{(errors * offsets).sum() / size:.2f}" if size / len(errors) > 1e-6 else ""
        return [f"{self.found}/{boards}", f"{1e3 * np.sqrt((errors**2).mean()):.1f}", left, time_ms]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boards", type=int, default=6, help="of every kind")
    boards = parser.parse_args().boards
    cv2.setNumThreads(1)
    print("| scene | found | RMS | left | ms | NEES | cv2 found | RMS | left | ms |\n|---|" + "---:|" * 9)
    for scene in SCENES:
        ours, theirs = Score(), Score()
        for number in range(boards):
            compare(scene, number, ours, theirs)
        honest = f"{np.concatenate(ours.squared).mean():.2f}" if ours.found else ""
        print("| " + " | ".join([scene.title, *ours.cells(boards), honest, *theirs.cells(boards)]) + " |", flush=True)


def compare(scene, number, ours, theirs):
    """Let both finders at one rendered board."""
    rng = np.random.default_rng([number, int(10 * scene.tilt_deg)])
    camera = Camera(model_named("opencv5"), SIZE, [FOCAL, FOCAL, 640, 480, scene.distortion, 0, 0, 0, 0])
    pose = held(scene, rng)
    gray = render(camera, scene.board, pose, rng=rng, exposure=scene.exposure)
    truth = camera.project(pose.apply(scene.board.points())).pixels
    offset = ellipse_centres(camera, scene.board, pose) - truth
    start = time.process_time()
    detection = find_circles(gray, scene.told or scene.board)
    ours.seconds.append(time.process_time() - start)
    if detection.found:
        ours.add(detection.pixels, detection.covariance, truth, offset)
    start = time.process_time()
    centres = opencv_centres(gray, scene.board)
    theirs.seconds.append(time.process_time() - start)
    if centres is not None:
        theirs.add(centres, None, truth, offset)


def held(scene, rng):
    """Return the pose of a board whose middle is near the image's, somewhere within a pixel."""
    azimuth = rng.uniform(0, 2 * np.pi)
    tilt = np.radians(scene.tilt_deg)
    turn = so3.exp(np.array([tilt * np.cos(azimuth), tilt * np.sin(azimuth), 0.0]))
    turn = turn @ so3.exp(np.array([0.0, 0.0, rng.uniform(-0.3, 0.3)]))
    distance = FOCAL * scene.board.spacing / scene.spacing_px
    middle = np.array([*scene.board.extent, 0.0]) / 2
    aside = np.append(rng.uniform(-20, 20, 2), 0.0) * distance / FOCAL
    return Pose(turn, np.array([0, 0, distance]) + aside - turn @ middle)


def ellipse_centres(camera, board, pose):
    """Return the centres (N, 2) of the ellipses that fit the outlines of the discs in the image."""
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    rim = board.diameter / 2 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(64)])
    points = (board.points()[:, None] + rim).reshape(-1, 3)
    outlines = camera.project(pose.apply(points)).pixels.reshape(board.count, 64, 2)
    middle = outlines.mean(axis=1)
    seen = 8 * (outlines - middle[:, None])  # single precision
    return middle + np.array([cv2.fitEllipse(outline.astype(np.float32))[0] for outline in seen]) / 8


def opencv_centres(gray, board):
    """Return the centres (N, 2) of findCirclesGrid, None where no way of asking it finds the board."""
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if board.type == ASYMMETRIC_CIRCLES else cv2.CALIB_CB_SYMMETRIC_GRID
    for image in (gray, cv2.bitwise_not(gray)):
        for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
            found, centres = cv2.findCirclesGrid(image, (board.columns, board.rows), flags=flags)
            if found:
                return centres.reshape(-1, 2)
    return None


if __name__ == "__main__":
    main()
