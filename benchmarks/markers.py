"""Corners of markers: camcal, OpenCV's refinements and the AprilTag library on the same rendered tags.

    python benchmarks/markers.py --trials 40 --family tag36h11

Tags tilted by up to 50° are rendered at any place within a pixel, their outlines integrated over each pixel. Errors
are root mean squares of a coordinate over the tags that a method found, in pixels; missed tags are in brackets, and so
is the NEES of camcal's covariance (1 is right). pupil-apriltags is compared where it is installed; its pixels have
their middle at 0.5, which is taken off.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from tagged import facing, photograph, pinhole, true_corners

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.simulate.render import Exposure
from camcal.targets.markers import detect_markers
from camcal.targets.pattern import family_named

SIZE = 0.05  # m
REFINEMENTS = ("NONE", "SUBPIX", "CONTOUR", "APRILTAG")
CELLS = [
    *((f"{side} px, blur 0.5, noise 2", side, 0.5, 2.0, 0.0) for side in (20, 40, 80, 160)),
    *((f"{side} px, blur 1.2, noise 2", side, 1.2, 2.0, 0.0) for side in (20, 40, 80, 160)),
    *((f"{side} px, blur 0.7, noise 8", side, 0.7, 8.0, 0.0) for side in (20, 40, 80, 160)),
    *((f"{side} px, barrel {-bend:g}", side, 0.7, 2.0, bend) for bend in (-0.15, -0.3) for side in (40, 100, 200)),
]


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--family", default="tag36h11")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    methods = finders(options.family)
    print(f"| {options.family}, {options.trials} tags a row | {' | '.join(methods)} |")
    print("|---" * (len(methods) + 1) + "|")
    spent = dict.fromkeys(methods, 0.0)
    for title, *cell in CELLS:
        print(f"| {title} | {' | '.join(row(methods, options, spent, *cell))} |", flush=True)
    times = (f"{1e3 * seconds / options.trials / len(CELLS):.1f}" for seconds in spent.values())
    print(f"| ms an image, detection included | {' | '.join(times)} |")


def finders(family):
    """Return functions gray -> {id: corners or (corners, covariance)} by their names."""
    found = {"camcal": lambda gray: ours(gray, family)}
    for name in REFINEMENTS:
        found[f"cv2 {name}"] = opencv_finder(family_named(family), getattr(cv2.aruco, f"CORNER_REFINE_{name}"))
    try:
        from pupil_apriltags import Detector
    except ImportError:
        return found
    if family.startswith("tag"):
        detector = Detector(families=family, quad_decimate=1.0)
        found["pupil-apriltags"] = lambda gray: {
            tag.tag_id: (np.array(tag.corners)[::-1] - 0.5, None) for tag in detector.detect(gray)
        }
    return found


def ours(gray, family):
    markers = detect_markers(gray, family)
    return {int(tag): pair for tag, *pair in zip(markers.ids, markers.corners, markers.covariance, strict=True)}


def opencv_finder(family, method):
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = method
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, family.dictionary))
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def find(gray):
        corners, ids, _ = detector.detectMarkers(gray)
        places = family.as_printed(np.reshape(corners, (-1, 4, 2))) if ids is not None else []
        return {int(tag): (four, None) for tag, four in zip(np.ravel(ids), places, strict=True)} if len(places) else {}

    return find


def row(methods, options, spent, side, blur, noise, bend):
    """Yield what every method makes of one kind of tag."""
    rng = np.random.default_rng(side)
    errors, nees = {name: [] for name in methods}, []
    for trial in range(options.trials):
        tag = trial % family_named(options.family).count
        camera, pose = view(rng, side, bend)
        exposure = Exposure(blur_px=blur, noise_dn=noise)
        gray = photograph(camera, [(tag, pose)], family=options.family, size=SIZE, seed=trial, exposure=exposure)
        truth = true_corners(camera, pose, SIZE)
        for name, find in methods.items():
            start = time.process_time()
            found = find(gray)
            spent[name] += time.process_time() - start
            if tag not in found:
                continue
            corners, covariance = found[tag]
            errors[name].append(corners - truth)
            if covariance is not None:
                off = corners - truth
                nees.append(np.einsum("ki,kij,kj->k", off, np.linalg.inv(covariance), off) / 2)
    for name, lists in errors.items():
        rms = f"{np.sqrt(np.mean(np.square(lists))):.3f}" if lists else "-"
        missed = options.trials - len(lists)
        extra = [f"{missed} missed"] * bool(missed) + [f"NEES {np.mean(nees):.2f}"] * bool(name == "camcal" and nees)
        yield rms + (f" ({', '.join(extra)})" if extra else "")


def view(rng, side, bend):
    """Return a camera with radial distortion `bend` and the pose of a tag whose side is about `side` px."""
    focal, size = 500.0, (640, 480) if bend else (int(2.2 * side) + 40,) * 2
    middle = np.array(size) / 2 - 0.5 + ([8, -6] if bend else [0, 0])
    camera = pinhole(size, focal)
    if bend:
        camera = Camera(model_named("opencv5"), size, np.array([focal, focal, *middle, bend, 0, 5e-4, -5e-4, 0]))
    room = np.maximum(np.array(size) / 2 - side - 10, 1) if bend else np.full(2, 1.0)
    distance = SIZE * focal / side
    place = rng.uniform(-room, room) / focal * distance
    tilt, azimuth, roll = np.radians(rng.uniform(0, 50)), *rng.uniform(-np.pi, np.pi, 2)
    pose = facing(*place, distance, (tilt * np.cos(azimuth), tilt * np.sin(azimuth), 0.0))
    turned = facing(0, 0, 0, (0.0, 0.0, roll)).rotation
    return camera, type(pose)(pose.rotation @ np.diag([1.0, -1, -1]) @ turned, pose.translation)


if __name__ == "__main__":
    main()
