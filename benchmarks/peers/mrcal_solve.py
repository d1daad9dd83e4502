"""mrcal's answer to the corners of a board, as JSON.

The last line of the output is the lens, [fx, fy, cx, cy, k1, k2, p1, p2, k3], for opencv8 with k4, k5, k6 as well; the
line before it is the points (C, 3) of the board as mrcal estimates it.

    INTERPRETER mrcal_solve.py FOLDER

FOLDER/data.npz: pixels (V, C, 2) with NaN for what was not seen, points (C, 3), size, focal, shape (columns, rows),
and optionally model, opencv5 or opencv8.
The interpreter is one that has the module mrcal (Debian: python3-mrcal); mrcal-calibrate-cameras is on the PATH.
"""

import json
import subprocess
import sys
from pathlib import Path

import mrcal
import numpy as np

MODELS = {"opencv5": "LENSMODEL_OPENCV5", "opencv8": "LENSMODEL_OPENCV8"}


def main() -> None:
    folder = Path(sys.argv[1])
    data = np.load(folder / "data.npz")
    write_corners(folder / "corners.vnl", data["pixels"])
    columns, rows = data["shape"]
    spacing = np.linalg.norm(data["points"][1] - data["points"][0])
    # Its best settings are its defaults: the board's warp and the rejection of outliers are on, and so is the
    # regularisation, which changes its errors by less than 1 % on the boards of board_shape.py. It must have a focal
    # length to start from.
    subprocess.run(
        [
            "mrcal-calibrate-cameras",
            *("--corners-cache", folder / "corners.vnl"),
            *("--lensmodel", MODELS[str(data.get("model", "opencv5"))]),
            *("--focal", str(data["focal"])),
            *("--imagersize", *map(str, data["size"])),
            *("--object-spacing", str(spacing)),
            *("--object-width-n", str(columns)),
            *("--object-height-n", str(rows)),
            *("--outdir", folder),
            "view*.png",
        ],
        check=True,
        cwd=folder,
        stdout=subprocess.DEVNULL,
    )
    camera = mrcal.cameramodel(str(folder / "camera-0.cameramodel"))
    warp = camera.optimization_inputs()["calobject_warp"]
    points = mrcal.ref_calibration_object(columns, rows, spacing, calobject_warp=warp)
    _, parameters = camera.intrinsics()
    print(json.dumps(points.reshape(-1, 3).tolist()))
    print(json.dumps(parameters.tolist()))


def write_corners(path: Path, pixels: np.ndarray) -> None:
    """Write one row a corner in mrgingham's table; a level of "-" says that the corner was not seen."""
    lines = ["# filename x y level"]
    for view, corners in enumerate(pixels):
        name = f"view{view:04d}.png"
        lines += [f"{name} - - -" if np.isnan(x) else f"{name} {x:.6f} {y:.6f} 0" for x, y in corners]
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
