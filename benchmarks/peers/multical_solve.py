"""Rig of cameras by multical from the corners in FOLDER/data.npz, as rig_scale.py writes them.

Prints the CPU seconds and the poses camera_T_first (N, 4, 4), a line of JSON each. Run by an interpreter that has
multical (0.4.0 needs Python 3.10 and OpenCV 4.6).

    PYTHON multical_solve.py FOLDER
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
from multical import tables
from multical.board.charuco import CharucoBoard
from multical.workspace import Workspace
from structs.struct import struct


def main() -> None:
    folder = Path(sys.argv[1])
    data = np.load(folder / "data.npz")
    pixels, (columns, rows), square = data["pixels"], data["shape"].tolist(), float(data["square"])
    names = [f"camera{index}" for index in range(len(pixels))]
    board = CharucoBoard((columns + 1, rows + 1), square, 0.8 * square, min_rows=1, min_points=6, aruco_dict="4X4_1000")

    def found(view: np.ndarray) -> struct:
        ids = np.flatnonzero(np.isfinite(view[:, 0]))
        return struct(corners=view[ids].astype(np.float32), ids=ids)

    start = time.process_time()
    work = Workspace(str(folder))
    images = [f"{index:04d}" for index in range(pixels.shape[1])]
    work.names = struct(camera=names, image=images, board=["board"])
    work.boards, work.image_size = [board], [tuple(data["size"].tolist())] * len(names)
    work.detected_points = [[[found(view)] for view in views] for views in pixels]
    work.point_table = tables.make_point_table(work.detected_points, work.boards)
    work.calibrate_single("standard", intrinsic_error_limit=10.0)
    work.initialise_poses()
    result = work.calibrate("calibration", cameras=True).with_master(names[0])
    seconds = time.process_time() - start
    print(seconds)
    print(json.dumps(np.array(result.camera_poses.pose_table.poses).tolist()))


if __name__ == "__main__":
    main()
