"""Time and truth of large rigs: cameras around a board, half of the views missing.

A row: cameras, captures, views with the board; CPU seconds of camcal, over the sum of the separate calibrations of all
cameras (5 at most wanted), over those of the row before by captures (near 1 if the time is linear); the errors of all
transforms: the largest in its standard deviation, and the RMS of all of them; the largest true error of a camera's
position in mm and of its rotation in degrees. --peers: cv2.calibrateMultiview (OpenCV 5), the cameras calibrated by
cv2.calibrateCamera first, from the views that have all corners; --multical: in an interpreter that has it, from all
corners. CPU seconds of the whole, and the errors.

    python benchmarks/rig_scale.py [--cameras 8] [--captures 37 75 150 300] [--hidden 0.5] [--peers] [--multical PYTHON]
    python benchmarks/rig_scale.py --cameras 4 --captures 1495 --hidden 0
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from rig_programs import camcal_rig, matrix_of, opencv_lens

from camcal.calibrate.intrinsics import Options, calibrate
from camcal.calibrate.rigs.record import Captures
from camcal.cameras.catalogue import model_named
from camcal.geometry import rotation as so3
from camcal.targets.board import Board

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rig_scenes import Errors, SimulatedRig, Transform, narrow_lens, observed, scene

BOARD = Board("chessboard", 9, 6, 0.04)
MODEL = model_named("opencv5")
SIZE = (1280, 960)
PEERS = Path(__file__).resolve().parent / "peers"


def ring(cameras: int) -> SimulatedRig:
    """Return cameras on an arc of 15° each about the place of the board, all looking there."""
    rng = np.random.default_rng(cameras)
    lenses = tuple(narrow_lens(rng, SIZE, focal) for focal in rng.uniform(900, 1300, cameras))
    pivot, poses = np.array([0, 0, 0.9]), []
    for index in range(cameras):
        turn = Transform.of([0, np.radians(15) * index, 0], [0, 0, 0])
        poses.append(Transform(turn.rotation, pivot - turn.rotation @ pivot + rng.normal(0, 0.01, 3) * (index > 0)))
    return SimulatedRig(lenses, tuple(poses), BOARD, (3e-4, -2e-4))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--captures", type=int, nargs="+", default=[37, 75, 150, 300])
    parser.add_argument("--hidden", type=float, default=0.5)
    parser.add_argument("--peers", action="store_true", help="cv2.calibrateMultiview as well")
    parser.add_argument("--multical", help="interpreter that has multical")
    parser.add_argument("--alone", action="store_true", help="the peers without camcal")
    arguments = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, numpy {np.__version__}; CPU seconds")
    print(
        f"{'cameras':>7} {'captures':>8} {'views':>6} {'camcal s':>9} {'cameras s':>9} {'ratio':>6} {'growth':>6} "
        f"{'largest σ':>9} {'rms σ':>6} {'mm':>7} {'deg':>7} {'MiB':>5}"
    )
    before = None
    for count in arguments.captures:
        rig = ring(arguments.cameras)
        captures = observed(scene(rig, count, count), Errors(0.1, hidden=arguments.hidden), count)
        if not arguments.alone:
            before = row(rig, captures, before)
        if arguments.peers:
            opencv_row(rig, captures)
        if arguments.multical:
            multical_row(arguments.multical, rig, captures)


def row(rig: SimulatedRig, captures: Captures, before: float | None) -> float:
    """Print the row of captures and return the CPU seconds of a capture; before: those of the row before."""
    start = time.process_time()
    result = camcal_rig(captures, rig.board, MODEL)
    seconds = time.process_time() - start
    start = time.process_time()
    for camera in range(len(rig.lenses)):
        calibrate([view for view in captures.of(camera) if view is not None], rig.board, Options(MODEL))
    alone = time.process_time() - start
    errors = transform_errors(rig, {name: (own.rotation, own.translation) for name, own in result.poses.items()})
    stds = np.stack([np.sqrt(np.diag(result.pose_covariance(name))) for name in rig.cameras[1:]])
    scores, each = errors / stds, seconds / len(captures)
    views = sum(view is not None for own in captures.views for view in own)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{len(rig.lenses):7d} {len(captures):8d} {views:6d} {seconds:9.2f} {alone:9.2f} {seconds / alone:6.2f} "
        f"{each / before if before else np.nan:6.2f} {np.abs(scores).max():9.2f} {np.sqrt(np.mean(scores**2)):6.2f} "
        f"{words_of(errors)} {peak:5.0f}",
        flush=True,
    )
    return each


def words_of(errors: np.ndarray) -> str:
    lengths = [np.linalg.norm(errors[:, part], axis=1).max() for part in (slice(3), slice(3, 6))]
    return f"{1e3 * lengths[0]:7.3f} {np.degrees(lengths[1]):7.4f}"


def transform_errors(rig: SimulatedRig, poses: dict[str, tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the errors (N − 1, 6) of camera_T_first, m and rad; a camera without a pose counts as NaN."""
    rows = []
    for name, truth in list(zip(rig.cameras, rig.poses, strict=True))[1:]:
        rotation, translation = poses.get(name, (np.full((3, 3), np.nan), np.full(3, np.nan)))
        turn = so3.log(rotation @ truth.rotation.T) if np.isfinite(rotation).all() else np.full(3, np.nan)
        rows.append(np.append(translation - truth.translation, turn))
    return np.array(rows)


def opencv_row(rig: SimulatedRig, captures: Captures) -> None:
    """Print what cv2.calibrateMultiview makes of the same corners."""
    if not hasattr(cv2, "calibrateMultiview"):
        print("  cv2.calibrateMultiview: not in this OpenCV")
        return
    points, cameras = rig.board.points().astype(np.float32), range(len(rig.lenses))
    whole = [
        [view if view is not None and len(view.ids) == rig.board.count else None for view in captures.of(camera)]
        for camera in cameras
    ]
    start = time.process_time()
    lenses = [opencv_lens([view for view in views if view is not None], rig.board, MODEL) for views in whole]
    pixels = [
        [np.zeros((0, 2), np.float32) if view is None else view.pixels.astype(np.float32) for view in views]
        for views in whole
    ]
    mask = np.array([[view is not None for view in views] for views in whole], np.uint8)
    try:
        found = cv2.calibrateMultiview(
            [points] * len(captures),
            pixels,
            [lens.image_size for lens in lenses],
            mask,
            np.zeros(len(lenses), np.uint8),
            [matrix_of(lens) for lens in lenses],
            [lens.parameters[4:].copy() for lens in lenses],
            None,
            None,
            flags=cv2.CALIB_USE_INTRINSIC_GUESS,
        )
    except cv2.error as error:
        print(f"  cv2.calibrateMultiview: {str(error).splitlines()[0][:120]}")
        return
    seconds = time.process_time() - start
    vectors, translations = found[3], found[4]
    poses = {
        name: (rotation if np.size(rotation) == 9 else cv2.Rodrigues(rotation)[0], np.ravel(translation))
        for name, rotation, translation in zip(rig.cameras, vectors, translations, strict=True)
    }
    errors = transform_errors(rig, poses)
    print(
        f"  cv2.calibrateMultiview, {int(mask.sum())} whole views: {seconds:.2f} s, largest errors in mm and degrees "
        f"{words_of(errors)}, RMS {found[0]:.3f} px",
        flush=True,
    )


def multical_row(interpreter: str, rig: SimulatedRig, captures: Captures) -> None:
    """Print what multical makes of the same corners."""
    pixels = np.full((len(rig.lenses), len(captures), rig.board.count, 2), np.nan)
    for index, row_of in enumerate(captures.views):
        for camera, view in enumerate(row_of):
            if view is not None:
                pixels[camera, index, view.ids] = view.pixels
    shape = (rig.board.columns, rig.board.rows)
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "data.npz", pixels=pixels, shape=shape, square=rig.board.spacing, size=SIZE)
        command = [interpreter, PEERS / "multical_solve.py", folder]
        own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        result = subprocess.run(command, check=False, capture_output=True, text=True, env=own)
    if result.returncode:
        print(f"  multical: {(result.stderr.strip().splitlines() or ['no message'])[-1]}")
        return
    seconds, poses = map(json.loads, result.stdout.splitlines()[-2:])
    named = {name: (pose[:3, :3], pose[:3, 3]) for name, pose in zip(rig.cameras, np.array(poses), strict=True)}
    errors = transform_errors(rig, named)
    print(f"  multical: {seconds:.2f} s, largest errors in mm and degrees {words_of(errors)}", flush=True)


if __name__ == "__main__":
    main()
