"""OCamCalib's calib_results.txt, read only, and the polynomial cameras of VINS-Fusion and MATLAB, counted otherwise.

OCamCalib has the centre as row and column, and [c d; e 1] acts on (row, column); there and in VINS-Fusion the
polynomial is that of a third axis backward, so that its first coefficient is below zero. In VINS-Fusion and MATLAB
[c d; e 1] acts on (u, v); MATLAB counts pixels from 1. The inverse polynomial is an approximation and is not read.
Source: Scaramuzza's OCamCalib toolbox, cam2world.c; camodocal, ScaramuzzaCamera.cc; MATLAB's fisheyeIntrinsics.
"""

import re
from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.formats.cameras.record import CAMERA, CameraFormat, Given, Source, read_only

_MOST = 5  # coefficients, of the powers 0 to 4


def polynomial_camera(
    size: tuple[int, int], polynomial: Array, stretch: Array, centre: tuple[float, float], where: str
) -> Camera:
    """Return the camera whose rays are (x, y, -Σ a_i r^i), u, v = stretch (2, 2) · (x, y) + centre, all in pixels.

    polynomial: (N,) the a_i, a_0 < 0, a_1 = 0. Raises InvalidInput for any other, and for more than five.
    """
    padded = np.pad(polynomial, (0, max(_MOST - len(polynomial), 0)))
    focal = -float(padded[0])
    if not (focal > 0 and padded[1] == 0 and len(padded) == _MOST and (np.diag(stretch) > 0).all()):
        what = "is no polynomial of degree 2 to 4 without a linear term, whose first coefficient is that of a lens"
        raise InvalidInput(f"{what}: calibrate with --model ocam", where=where)
    terms = -padded[2:] * focal ** np.arange(1, 4)
    core = [focal * stretch[0, 0], focal * stretch[1, 1], *centre]
    shears = [stretch[0, 1] / stretch[0, 0], stretch[1, 0] / stretch[1, 1]]
    return Camera(model_named("ocam"), size, np.array([*core, *terms, *shears]))


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera; raises InvalidInput for what is missing, or of a lens that camcal does not have."""
    where = str(sources[0].path)
    lines = [line for line in sources[0].text.splitlines() if re.match(r"\s*[-+.\d]", line)]
    try:
        numbers = [np.array([float(word) for word in line.split()]) for line in lines[:5]]
        (count, *polynomial), _, (row, column), (c, d, e), (height, width) = (each.tolist() for each in numbers)
    except ValueError as error:
        what = "has not polynomial, inverse, center, affine parameters and image size, each on its line of numbers"
        raise InvalidInput(what, where=where) from error
    if count != len(polynomial) or not np.isfinite(np.concatenate(numbers)).all():
        raise InvalidInput(f"has {len(polynomial)} coefficients where it counts {count:g}, or no numbers", where=where)
    size = given.size((int(width), int(height)), where)
    stretch = np.array([[1.0, e], [d, c]])
    return CameraFile(
        {CAMERA: CameraEntry(polynomial_camera(size, np.array(polynomial), stretch, (column, row), where))}
    )


FORMAT = CameraFormat(
    name="ocamcalib",
    title="OCamCalib calib_results.txt",
    suffixes=(),
    models=("ocam",),
    read=read,
    write=read_only("OCamCalib"),
)
