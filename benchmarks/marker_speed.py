"""Time that tags take: a fit of ordinary and of razor-sharp tags, and sheets of 280 tags with unique and repeated ids.

Ordinary tags are rendered, 20 to 160 px wide, blur 0.5 to 1.2 px; razor-sharp ones are OpenCV's pictures pasted as they
are, or warped by nearest pixels. Medians of CPU time, one thread; `aruco` is cv2.aruco's detection without refinement.

    python benchmarks/marker_speed.py [--runs 5]
"""

import argparse
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from tagged import facing, photograph, pinhole

from camcal.simulate.render import Exposure
from camcal.targets.markers import detect_markers

FAMILY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
CELLS = [(side, blur) for blur in (0.5, 0.8, 1.2) for side in (20, 40, 80, 160)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    cv2.setNumThreads(1)
    detector = cv2.aruco.ArucoDetector(FAMILY)
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}")
    for name, images in (("ordinary", ordinary()), ("razor-sharp", razor_sharp())):
        ours = sum(seconds(lambda gray=gray: detect_markers(gray, "tag36h11"), runs) for gray in images)
        aruco = sum(seconds(lambda gray=gray: detector.detectMarkers(gray), runs) for gray in images)
        print(f"{name:24}{1e3 * (ours - aruco) / len(images):8.1f} ms a tag", flush=True)
    for name, different in (("280 ids", 280), ("140 ids twice each", 140)):
        gray = sheet(different)
        count = len(detect_markers(gray, "tag36h11").ids)
        ours = seconds(lambda gray=gray: detect_markers(gray, "tag36h11"), 1)
        print(f"{name:24}{ours:8.2f} s, {count} tags", flush=True)
    print(f"{'aruco':24}{seconds(lambda: detector.detectMarkers(sheet(280)), runs):8.2f} s")


def seconds(work: Callable[[], object], runs: int) -> float:
    """Return the median CPU time of some work."""
    spent = []
    for _ in range(runs):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return float(np.median(spent))


def ordinary() -> list[np.ndarray]:
    rng, camera, images = np.random.default_rng(5), pinhole(), []
    for number, (side, blur) in enumerate(CELLS):
        far = 600 * 0.05 / side
        pose = facing(*(0.1 * far * rng.uniform(-1, 1, 2)), far, rng.normal(0, 0.35, 3))
        images.append(photograph(camera, [(number, pose)], seed=number, exposure=Exposure(blur_px=blur, noise_dn=2.0)))
    return images


def razor_sharp() -> list[np.ndarray]:
    images = []
    for number, side in enumerate((80, 96, 120, 160, 104)):
        gray = np.full((480, 640), 255, np.uint8)
        gray[100 + number :, 150:][:side, :side] = cv2.aruco.generateImageMarker(FAMILY, number, side)
        square = np.array([[150, 100], [400, 100], [400, 350], [150, 350]], np.float32)
        seen = np.array([[160 + number, 110], [390, 95 - number], [405, 360], [140, 330]], np.float32)
        warp = cv2.getPerspectiveTransform(square, seen)
        images += [gray, cv2.warpPerspective(gray, warp, (640, 480), flags=cv2.INTER_NEAREST, borderValue=255)]
    return images


def sheet(different: int) -> np.ndarray:
    """Return a sheet of 20 x 14 tags of 50 px with so many different ids."""
    gray = np.full((14 * 70 + 40, 20 * 70 + 40), 230, np.uint8)
    for place in range(280):
        row, column = divmod(place, 20)
        tag = cv2.aruco.generateImageMarker(FAMILY, place % different, 50)
        gray[28 + 70 * row :, 28 + 70 * column :][:50, :50] = tag
    return cv2.GaussianBlur(gray, (0, 0), 0.8)


if __name__ == "__main__":
    main()
