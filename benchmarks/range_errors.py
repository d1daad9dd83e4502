"""Whether errors of points, lengths and depths at a distance are as `camcal inspect --at` states them.

The same views are measured again and again with fresh noise and calibrated. Views are those of camcal's simulation, and
those of tests/rig_scenes.py, which has nothing of camcal but its records: cv2.projectPoints, bent boards, errors that
are smooth over the board. Every row is one quantity at one distance: the distance over that of the boards (median), the
RMS error over the runs (of points the RMS over the image where corners are, else the median), what the calibrations
state (RMS over the runs), and stated over observed (0.85 to 1.15 wanted).
point: px, of points that the boards of all views place, a rotation left out. length: of an object of 1/8 of the
distance, whose ends are seen at their true pixels and are at that distance. depth: of points triangulated from their
true pixels.

    python benchmarks/range_errors.py [--runs 60] [--cases NAME …] [--jobs 2]
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import sys
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
from rig_programs import camcal_rig

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import grid_pixels
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CalibrationVerdict, CameraEntry, CameraFile, JointCovariance, Transform
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.projection_uncertainty import KnownRegion, in_polygon
from camcal.quality.range_uncertainty import CalibrationBoards, objects
from camcal.run.fanout import fan_out
from camcal.simulate.scene import make_camera, observe, views
from camcal.targets.board import Board
from camcal.tasks.calibration.errors_at_range import errors_at_range

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rig_scenes import Errors, Scene, SimulatedRig, narrow_lens, observed, scene, wide_lens
from rig_scenes import Transform as Place

SIZE, BOARD, TIMES, SHARE = (1280, 960), Board("chessboard", 9, 6, 0.025), (0.5, 1.0, 3.0), 1 / 8


@dataclass(frozen=True, eq=False)
class Case:
    """What is simulated. cameras, second_T_first: the truth. poses: first_T_board. measured: from a seed to the views
    of each camera. lift: m, by which the middle of a bent board is nearer to the estimate of its plane.
    """

    cameras: tuple
    poses: tuple
    measured: object
    second_T_first: Pose | None = None
    lift: float = 0.0

    @property
    def distances(self):
        """Distances from the first camera."""
        return np.median([np.linalg.norm(pose.translation) for pose in self.poses]) * np.array(TIMES)


def simulated(model, count, noise):
    """Return views of camcal's simulation."""
    camera = make_camera(model_named(model), SIZE, np.radians(130 if model == "kannala_brandt4" else 70))
    poses = views(camera, BOARD, count, rng=np.random.default_rng(5))

    def measured(seed):
        rng = np.random.default_rng([seed, 3])
        return observe(camera, BOARD, poses, rng=rng, noise_px=noise)[0].views

    return Case((camera,), tuple(poses), measured)


def of_scene(lens, focal, captures, errors, seed, *, pair, bow=(0.0, 0.0)):
    """Return captures of rig_scenes.py by two cameras, or the views of one."""
    rng = np.random.default_rng(seed)
    lenses = tuple(lens(rng, SIZE, focal * times) for times in ((1.0, 1.01) if pair else (1.0,)))
    places = (Place.of([0, 0, 0], [0, 0, 0]), Place.of([0.01, -0.03, 0.005], [-0.12, 0.002, 0.004]))[: len(lenses)]
    made: Scene = scene(SimulatedRig(lenses, places, BOARD, bow), captures, seed)
    cameras = tuple(Camera(model_named(own.model), SIZE, own.parameters) for own in lenses)
    poses = tuple(Pose(own.rotation, own.translation) for own in made.boards)
    second = Pose(places[1].rotation, places[1].translation) if pair else None

    def measured(run):
        found = observed(made, errors, run)
        return found if pair else [view for view in found.of(0) if view is not None]

    return Case(cameras, poses, measured, second, 2 / 3 * sum(bow))


CASES = {
    "simulated, 15 views": lambda: simulated("opencv5", 15, 0.1),
    "simulated, wide, 12 views": lambda: simulated("kannala_brandt4", 12, 0.2),
    "scenes, 20 views": lambda: of_scene(narrow_lens, 1150.0, 20, Errors(0.15), 1, pair=False, bow=(4e-4, -2e-4)),
    "scenes, wide, 20 views": lambda: of_scene(wide_lens, 400.0, 20, Errors(0.1), 4, pair=False),
    "scenes, smooth errors": lambda: of_scene(narrow_lens, 1150.0, 20, Errors(0.07, smooth=0.1), 2, pair=False),
    "scenes, two cameras": lambda: of_scene(narrow_lens, 1150.0, 15, Errors(0.1), 3, pair=True),
    "scenes, two, 30 captures": lambda: of_scene(narrow_lens, 1150.0, 30, Errors(0.1), 5, pair=True),
    "scenes, two wide cameras": lambda: of_scene(wide_lens, 400.0, 15, Errors(0.1), 6, pair=True),
}


@cache
def case(name):
    return CASES[name]()


@cache
def hull(name):
    """Return the polygon around the corners that the first camera sees."""
    own = case(name)
    points = np.concatenate([own.cameras[0].project(pose.apply(BOARD.points())).pixels for pose in own.poses])
    inside = ((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1)
    return cv2.convexHull(points[inside].astype(np.float32))[:, 0].astype(float)


def places(name):
    """Return the pixels (N, 2) and rays of a grid over the part of the first camera's image that corners cover."""
    pixels = grid_pixels(*(np.linspace(0, side - 1, count) for side, count in zip(SIZE, (31, 23), strict=True)))
    pixels = pixels[in_polygon(pixels, hull(name))]
    return pixels, case(name).cameras[0].unproject(pixels).directions


def run(name, seed):
    """Return (quantity, index of the distance): squared errors (N,) at all places and the stated variance, of a run."""
    own = case(name)
    found = own.measured(seed)
    verdict = CalibrationVerdict(True, (), KnownRegion(1.0, 1.0, 1.0, hull(name)))
    if own.second_T_first is None:
        result = calibrate(found, BOARD, Options(own.cameras[0].model))
        entry = CameraEntry(result.camera, quality={"images_used": len(result.used)}, verdict=verdict)
        file = CameraFile({"left": CameraEntry(**vars(entry) | {"boards": CalibrationBoards.of(result)})})
    else:
        result = camcal_rig(found, BOARD, own.cameras[0].model)
        entries = {key: CameraEntry(each.camera, verdict=verdict) for key, each in result.calibrations.items()}
        step = Transform(result.poses["right"], result.pose_covariance("right"))
        joint = JointCovariance(result.names, result.covariance_of(result.names))
        file = CameraFile(entries, {result.transform_name("right"): step}, joint)
    rows = {}
    for index, distance in enumerate(own.distances.tolist()):
        stated = errors_at_range(file, distance, SHARE * distance)
        left, estimate = stated.cameras["left"], file.cameras["left"].camera
        if own.second_T_first is None:
            rows["point", index] = point_error(name, result, distance), left.point.std**2
        else:
            [pair] = stated.pairs
            depth, length = pair_errors(name, estimate, result, distance)
            rows["depth", index] = depth, pair.depth.std**2
            rows["length by two", index] = length, pair.length.std**2
        rows["length", index] = length_error(name, estimate, distance), left.length.std**2
    return rows


def point_error(name, result, distance):
    """Return the squared errors of coordinates of points that the boards place, a rotation left out."""
    truth, (pixels, rays) = case(name).cameras[0], places(name)
    used = {view.image: view.camera_T_board for view in result.used}
    names = [view.image for view in result.views]
    lift = Pose(np.eye(3), np.array([0.0, 0.0, case(name).lift]))  # the bow 1 - x² is -2/3 P2(x) of a deeper board
    poses = [pose @ lift for pose in case(name).poses]
    steps = [used[each] @ pose.inverse() for each, pose in zip(names, poses, strict=True) if each in used]
    shift = np.mean([step.translation for step in steps], axis=0)
    moved = result.camera.project(distance * rays + shift).pixels - pixels
    by_turn = (truth.project_with_jacobians(rays).d_point @ -so3.hat(rays)).reshape(-1, 3)
    turn = np.linalg.lstsq(by_turn, moved.ravel(), rcond=None)[0]
    return (moved.ravel() - by_turn @ turn) ** 2


def length_error(name, estimate, distance):
    """Return the squared errors of lengths by the angle between their ends."""
    truth, (_, rays) = case(name).cameras[0], places(name)
    _, *ends = objects(rays, distance, SHARE * distance)
    pixels = [truth.project(each).pixels for each in ends]
    seen = np.all([in_polygon(each, hull(name)) for each in pixels], axis=0)
    first, last = (distance * estimate.unproject(each[seen]).directions for each in pixels)
    return (np.linalg.norm(last - first, axis=1) - SHARE * distance) ** 2


def pair_errors(name, estimate, result, distance):
    """Return the squared errors of depths and lengths by two cameras."""
    own, other = case(name), result.calibrations["right"].camera
    width, height = SIZE
    pixels = grid_pixels(np.linspace(0, width, 24), np.linspace(0, height, 18))
    rays = own.cameras[0].unproject(pixels)
    points = distance * rays.directions[rays.valid]
    points = points[in_second(own, points)]
    depth = np.linalg.norm(triangulated(own, estimate, other, result.poses["right"], points), axis=1) - distance
    _, *ends = objects(points / distance, distance, SHARE * distance)
    seen = np.all([in_second(own, each) & in_first(own, each) for each in ends], axis=0)
    first, last = (triangulated(own, estimate, other, result.poses["right"], each[seen]) for each in ends)
    length = np.linalg.norm(last - first, axis=1) - SHARE * distance
    return depth**2, length**2


def in_first(own, points):
    seen = own.cameras[0].project(points)
    return seen.valid & ((seen.pixels > -0.5) & (seen.pixels < np.array(SIZE) - 0.5)).all(axis=1)


def in_second(own, points):
    seen = own.cameras[1].project(own.second_T_first.apply(points))
    return seen.valid & ((seen.pixels > -0.5) & (seen.pixels < np.array(SIZE) - 0.5)).all(axis=1)


def triangulated(own, first, second, second_T_first, points):
    """Return the points nearest to both rays of the true pixels, by the estimated cameras."""
    one = first.unproject(own.cameras[0].project(points).pixels).directions
    seen = own.cameras[1].project(own.second_T_first.apply(points)).pixels
    two = second.unproject(seen).directions @ second_T_first.rotation
    centre = -second_T_first.rotation.T @ second_T_first.translation
    eye = np.eye(3)
    flat = [eye - each[:, :, None] * each[:, None] for each in (one, two)]
    return np.linalg.solve(flat[0] + flat[1], (flat[1] @ centre)[..., None])[..., 0]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), metavar="NAME")
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    print("| case | error of | distance / boards | observed | stated | stated / observed |\n|---|---|---|---|---|---|")
    for name in arguments.cases:
        outcomes = fan_out(partial(run, name), range(arguments.runs), jobs=arguments.jobs, processes=True)
        found = []
        for outcome in outcomes:
            if outcome.error is not None:
                print(f"# {name}, seed {outcome.item}: {outcome.error}", file=sys.stderr)
            else:
                found.append(outcome.value)
        for what, index in found[0]:
            squares = np.mean([each[what, index][0] for each in found], axis=0)
            seen = np.sqrt(np.mean(squares) if what == "point" else np.median(squares))
            stated = np.sqrt(np.mean([each[what, index][1] for each in found]))
            factor, unit = (1.0, "px") if what == "point" else (1e3, "mm")
            sizes = " | ".join(f"{factor * value:.3g} {unit}" for value in (seen, stated))
            print(f"| {name} | {what} | {TIMES[index]:g} | {sizes} | {stated / seen:.2f} |", flush=True)


if __name__ == "__main__":
    main()
