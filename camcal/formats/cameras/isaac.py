"""A camera of Isaac Sim (USD) whose lens is two tables, of any lens model: OmniLensDistortionLutAPI.

The first, over the image from its top left corner, has rays with x right, y up, z back, (0, 0, 1) where there is none.
The second, over all directions in octahedral coordinates with forward in the middle, has places in the image as shares
of its width and height, -1 for directions that it does not show. The principal point is in the tables.
Source: NVIDIA's schema of lens distortion; Cigolle et al., A survey of efficient representations for independent unit
vectors, JCGT 2014 (octahedral coordinates).
"""

from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.directions import grid_pixels
from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras.record import EVERY_LENS, CameraFormat, write_only
from camcal.formats.exr import write_exr

_OPTICAL_TO_USD = np.array([1.0, -1.0, -1.0])
_NO_RAY, _NO_PLACE = (0.0, 0.0, 1.0), -1.0
_PIXELS = 1024  # a side of the second table, or as many as the image has


def outputs(path: Path, file: CameraFile) -> tuple[Path, ...]:
    """Return the camera and its two tables."""
    del file
    return path, path.with_suffix(".rays.exr"), path.with_suffix(".places.exr")


def write(path: Path, file: CameraFile) -> None:
    """Write a camera and its tables; raises FileError."""
    (entry,) = file.cameras.values()
    camera, (_, rays, places) = entry.camera, outputs(path, file)
    width, height = camera.image_size
    write_exr(rays, dict(zip("RGB", _rays(camera), strict=True)))
    write_exr(places, dict(zip("RG", _places(camera), strict=True)))
    schema = "omni:lensdistortion"
    lines = [
        "#usda 1.0",
        "(",
        '    defaultPrim = "Camera"',
        ")",
        "",
        'def Camera "Camera" (',
        '    prepend apiSchemas = ["OmniLensDistortionLutAPI"]',
        ")",
        "{",
        f'    uniform token {schema}:model = "lut"',
        f"    float {schema}:lut:nominalWidth = {width}",
        f"    float {schema}:lut:nominalHeight = {height}",
        f"    float2 {schema}:lut:opticalCenter = ({width / 2:g}, {height / 2:g})",
        f"    asset {schema}:lut:rayEnterDirectionTexture = @./{rays.name}@",
        f"    asset {schema}:lut:rayExitPositionTexture = @./{places.name}@",
        "}",
        "",
    ]
    files.write_text(path, "\n".join(lines))


def _rays(camera: Camera) -> Array:
    """Return the rays (3, H, W) of the pixels of an image."""
    width, height = camera.image_size
    found = camera.unproject(grid_pixels(np.arange(width), np.arange(height)))
    rays = np.where(found.valid[:, None], found.directions * _OPTICAL_TO_USD, _NO_RAY)
    return np.asarray(rays.T.reshape(3, height, width))


def _places(camera: Camera) -> Array:
    """Return where (2, S, S) in the image directions in octahedral coordinates are, as shares of its sides."""
    side = max(_PIXELS, *camera.image_size)
    middles = (np.arange(side) + 0.5) / side * 2 - 1
    x, y = grid_pixels(middles, middles).T
    z = 1 - np.abs(x) - np.abs(y)
    back = z < 0
    x, y = (np.where(back, (1 - np.abs(other)) * np.where(own >= 0, 1.0, -1.0), own) for own, other in ((x, y), (y, x)))
    directions = np.column_stack([x, y, -z]) * _OPTICAL_TO_USD
    found = camera.project(directions)
    shares = (found.pixels + 0.5) / np.array(camera.image_size)
    shown = found.valid & (shares >= 0).all(axis=1) & (shares <= 1).all(axis=1)
    return np.asarray(np.where(shown[:, None], shares, _NO_PLACE).T.reshape(2, side, side))


ISAAC = CameraFormat(
    name="isaac",
    title="Isaac Sim camera with tables",
    suffixes=(".usda",),
    models=EVERY_LENS,
    read=write_only("Isaac Sim camera"),
    write=write,
    outputs=outputs,
    most_cameras=1,
    note="OmniLensDistortionLutAPI: opticalCenter stays the middle, the tables have the principal point",
)
