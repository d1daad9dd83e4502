"""lensboy's answer to the corners of a board: the last line is [fx, fy, cx, cy, k1, k2, p1, p2, k3] as JSON.

    INTERPRETER lensboy_solve.py FOLDER

FOLDER/data.npz: pixels (V, C, 2) with NaN for what was not seen, points (C, 3), size, focal, shape (columns, rows).
The interpreter is one of an environment with `pip install lensboy`.
"""

import json
import sys
from pathlib import Path

import lensboy
import numpy as np


def main() -> None:
    data = np.load(Path(sys.argv[1]) / "data.npz")
    width, height = map(int, data["size"])
    seen = [np.flatnonzero(~np.isnan(corners[:, 0])) for corners in data["pixels"]]
    frames = [lensboy.Frame(ids, corners[ids]) for ids, corners in zip(seen, data["pixels"], strict=True)]
    # Its best settings are its defaults: the warp of five terms and the rejection of outliers are on; the
    # coefficients are those of opencv5. It starts from the true focal length, as mrcal does.
    config = lensboy.OpenCVConfig(
        image_height=height,
        image_width=width,
        initial_focal_length=float(data["focal"]),
        included_distortion_coefficients=lensboy.OpenCVConfig.STANDARD,
    )
    result = lensboy.calibrate_camera(data["points"], frames, config, estimate_target_warp=True)
    lens = result.camera_model
    print(json.dumps([lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion_coeffs[:5].tolist()]))


if __name__ == "__main__":
    main()
