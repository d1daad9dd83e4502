"""lensboy's answer to the corners of a board, as JSON.

The last line of the output is the lens, [fx, fy, cx, cy, k1, k2, p1, p2, k3], for opencv8 with k4, k5, k6 as well; the
line before it is the points (C, 3) of the board as lensboy estimates it.

    INTERPRETER lensboy_solve.py FOLDER

FOLDER/data.npz: pixels (V, C, 2) with NaN for what was not seen, points (C, 3), size, focal, shape (columns, rows),
and optionally model, opencv5 or opencv8.
The interpreter is one of an environment with `pip install lensboy`.
"""

import json
import sys
from pathlib import Path

import lensboy
import numpy as np

COEFFICIENTS = {"opencv5": 5, "opencv8": 8}


def main() -> None:
    data = np.load(Path(sys.argv[1]) / "data.npz")
    width, height = map(int, data["size"])
    seen = [np.flatnonzero(~np.isnan(corners[:, 0])) for corners in data["pixels"]]
    frames = [lensboy.Frame(ids, corners[ids]) for ids, corners in zip(seen, data["pixels"], strict=True)]
    count = COEFFICIENTS[str(data.get("model", "opencv5"))]
    # Its best settings are its defaults: the warp of five terms and the rejection of outliers are on. It starts from
    # the focal length given, as mrcal does.
    config = lensboy.OpenCVConfig(
        image_height=height,
        image_width=width,
        initial_focal_length=float(data["focal"]),
        included_distortion_coefficients=np.arange(14) < count,
    )
    result = lensboy.calibrate_camera(data["points"], frames, config, estimate_target_warp=True)
    lens = result.camera_model
    warp = result.target_warp
    points = data["points"] if warp is None else warp.warp_target(data["points"])
    print(json.dumps(np.asarray(points).tolist()))
    print(json.dumps([lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion_coeffs[:count].tolist()]))


if __name__ == "__main__":
    main()
