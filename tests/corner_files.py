"""Corner lists as MATLAB, Bouguet's toolbox, PhotonVision and Deltille write them, of a chessboard in five views."""

import json

import numpy as np
from scipy.io import savemat

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.simulate.scene import observe, views
from camcal.targets.board import parse_board

BOARD = parse_board("chessboard:9x6:25mm")
SIZE = (1280, 960)
CAMERA = Camera(model_named("pinhole"), SIZE, np.array([900.0, 902, 640, 478]))
PHOTON = {"resolution": {"width": 1280.0, "height": 960.0}, "cameraIntrinsics": {}, "calobjectSpacing": 0.025}


def seen_views():
    """Return detections of all corners without errors."""
    rng = np.random.default_rng(5)
    found, _ = observe(CAMERA, BOARD, views(CAMERA, BOARD, 5, rng=rng), rng=rng, noise_px=0.0)
    assert all(len(view.ids) == BOARD.count for view in found.views)
    return found.views


def grids(seen):
    """Return the pixels (P, rows, columns, 2) of all views, counted from 0."""
    return np.stack([view.pixels.reshape(BOARD.rows, BOARD.columns, 2) for view in seen])


def matlab(path, seen, save=savemat, **more):
    """Write what detectCheckerboardPoints and generateCheckerboardPoints give: down the columns, from 1."""
    down = grids(seen).transpose(0, 2, 1, 3).reshape(len(seen), -1, 2)
    x, y = np.meshgrid(np.arange(9), np.arange(6))
    world = 25.0 * np.column_stack([x.T.ravel(), y.T.ravel()])
    save(path, {"imagePoints": down.transpose(1, 2, 0) + 1, "worldPoints": world, **more})
    return path


def bouguet(path, seen, save=savemat):
    """Write calib_data.mat: y upwards from the first corner, mm, and an image without corners."""
    x, y = np.meshgrid(np.arange(9), np.arange(5, -1, -1))
    points = 25.0 * np.stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    data = {"n_ima": len(seen) + 1.0, "nx": 1280.0, "ny": 960.0, "calib_name": "left", "dX": 25.0, "dY": 25.0}
    for number, grid in enumerate(grids(seen), 1):
        data |= {f"x_{number}": grid.reshape(-1, 2).T, f"X_{number}": points, f"n_sq_x_{number}": 8.0}
    data |= {f"x_{len(seen) + 1}": np.full((2, 1), np.nan), f"X_{len(seen) + 1}": np.full((3, 1), np.nan)}
    save(path, data)
    return path


def photonvision(path, seen):
    """Write a calibration with its observations, m; the third corner of the second image was not found."""
    x, y = np.meshgrid(np.arange(9), np.arange(6))
    points = [{"x": 0.025 * u, "y": 0.025 * v, "z": 0.0} for u, v in zip(x.ravel(), y.ravel(), strict=True)]
    observations = []
    for number, view in enumerate(seen):
        pixels = [{"x": u, "y": v} for u, v in view.pixels.tolist()]
        if number == 1:
            pixels[2] = {"x": -1.0, "y": -1.0}
        name = f"img{number}.png"
        each = {"locationInObjectSpace": points, "locationInImageSpace": pixels, "snapshotName": name}
        observations.append({**each, "reprojectionErrors": [], "cornersUsed": [True] * 54})
    path.write_text(json.dumps({**PHOTON, "observations": observations}))
    return path


def deltille(path, view):
    """Write an .orpc file: 17 digits, ids of a checkerboard along its rows."""
    rows = [f"0,{number},1,{u:.17g},{v:.17g}" for number, (u, v) in zip(view.ids, view.pixels.tolist(), strict=True)]
    head = f"filename: {view.image}\nwidth: 1280\nheight: 960\nnum_corners: {len(rows)}\nencoding: ascii\n"
    path.write_text(head + "\n".join(rows) + "\n")
    return path
