"""`camcal stereo cloud`: a disparity map and a camera to a coloured point cloud."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camcal.errors import InvalidInput
from camcal.formats import disparity, native, pointcloud
from camcal.formats.camera_file import CameraFile
from camcal.formats.disparity import DisparityMap
from camcal.geometry.pose import Pose
from camcal.images.load import load
from camcal.progress import SILENT, Progress
from camcal.run.inputs import split_address
from camcal.run.outputs import refuse_overwriting
from camcal.stereo.cloud import PointCloud, make_cloud
from camcal.stereo.geometry import StereoGeometry, of_pair, pinhole_intrinsics

CAMERA_SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class CloudOptions:
    """A disparity map, the left image, and where the geometry comes from.

    files: the image and the camera file (FILE or FILE#NAME), either or both, told apart by the suffix.
    camera: name of the left camera in the file. fx … doffs: pixels and metres; each wins over the camera file.
    scale: counts of the file per pixel of disparity, None by its type. min_depth, max_depth: metres.
    """

    disparity: Path
    output: Path
    files: tuple[str, ...] = ()
    camera: str | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    baseline: float | None = None
    doffs: float | None = None
    scale: float | None = None
    min_depth: float = 0.0
    max_depth: float = float("inf")
    ascii_text: bool = False


@dataclass(frozen=True)
class CloudReport:
    """What was written: points of so many pixels, the scale the disparity was read with, the geometry.

    depth: smallest, median and largest z, metres, None for an empty cloud. appearance: colour, gray or none.
    """

    output: Path
    points: int
    pixels: int
    scale: float
    geometry: StereoGeometry
    depth: tuple[float, float, float] | None
    appearance: str


def stereo_cloud(options: CloudOptions, progress: Progress = SILENT) -> CloudReport:
    """Return what was written to options.output.

    Raises InvalidInput for a geometry that is incomplete or not rectified, or sizes that differ; FileError.
    """
    pointcloud.require_suffix(options.output)
    image_path, address = _image_and_camera(options.files)
    refuse_overwriting([options.output], [options.disparity, *([image_path] if image_path else [])])
    found = disparity.read(options.disparity, options.scale)
    geometry = _geometry(options, address, found, progress)
    image = load(image_path).pixels if image_path else None
    cloud = make_cloud(found.values, geometry, image, (options.min_depth, options.max_depth))
    if not len(cloud.points):
        progress.warn(f"{options.disparity}: no pixel has a match in the depth range; the cloud is empty")
    pointcloud.write(options.output, cloud, ascii_text=options.ascii_text)
    return _report(options.output, found, geometry, cloud)


def _image_and_camera(files: tuple[str, ...]) -> tuple[Path | None, str | None]:
    cameras = [text for text in files if split_address(text)[0].suffix.lower() in CAMERA_SUFFIXES]
    images = [Path(text) for text in files if text not in cameras]
    if len(cameras) > 1 or len(images) > 1:
        raise InvalidInput(f"one image and one camera file are taken, found {' and '.join(files)}")
    return (images[0] if images else None), (cameras[0] if cameras else None)


def _geometry(options: CloudOptions, address: str | None, found: DisparityMap, progress: Progress) -> StereoGeometry:
    """Return the geometry of the camera file with the numbers that were given put over it."""
    known: dict[str, float] = {}
    if address is not None:
        known = _from_file(address, options, found, progress)
    given = {name: getattr(options, name) for name in ("fx", "fy", "cx", "cy", "baseline", "doffs")}
    known |= {name: value for name, value in given.items() if value is not None}
    missing = [f"--{name}" for name in ("fx", "cx", "cy", "baseline") if name not in known]
    if missing:
        source = "the camera file has no camera to the right of it: " if address else ""
        raise InvalidInput(f"{source}give {', '.join(missing)}, or a camera file of the rectified pair")
    return StereoGeometry(**{"fy": known["fx"], **known})


def _from_file(address: str, options: CloudOptions, found: DisparityMap, progress: Progress) -> dict[str, float]:
    """Return what a camera file says of the pair: all of it, or fx, fy, cx, cy where it holds a single camera."""
    path, named = split_address(address)
    name = options.camera or named
    file = native.read(path)
    for warning in file.warnings:
        progress.warn(warning)
    pair = _pair(file, name)
    left = file.cameras[pair[0]].camera if pair else native.select(file, name, str(path)).camera
    height, width = found.values.shape
    if left.image_size != (width, height):
        size = "{} × {}".format(*left.image_size)
        raise InvalidInput(f"the camera has {size} pixels, the disparity map {width} × {height}", where=address)
    try:
        if pair is None:
            return dict(zip(("fx", "fy", "cx", "cy"), pinhole_intrinsics(left), strict=True))
        return asdict(of_pair(left, file.cameras[pair[1]].camera, pair[2]))
    except InvalidInput as error:
        raise InvalidInput(error.message, where=address) from error


def _pair(file: CameraFile, name: str | None) -> tuple[str, str, Pose] | None:
    """Return the names of the left and the right camera and right_T_left, None if no transform joins two cameras.

    name: the left camera, None for whichever stands left.
    """
    pairs = []
    for key, transform in file.transforms.items():
        a, b = key.split("_T_")
        if a in file.cameras and b in file.cameras:
            a_T_b = transform.pose
            pairs.append((b, a, a_T_b) if a_T_b.translation[0] < 0 else (a, b, a_T_b.inverse()))
    fitting = [pair for pair in pairs if name in (None, pair[0])]
    if len(fitting) > 1:
        raise InvalidInput(f"the camera file has {len(fitting)} pairs; give the geometry by --fx --cx --cy --baseline")
    return fitting[0] if fitting else None


def _report(output: Path, found: DisparityMap, geometry: StereoGeometry, cloud: PointCloud) -> CloudReport:
    depth = cloud.points[:, 2]
    appearance = "none" if cloud.colours is None else "colour" if cloud.intensity is None else "gray"
    return CloudReport(
        output=output,
        points=len(depth),
        pixels=found.values.size,
        scale=found.scale,
        geometry=geometry,
        depth=(float(depth.min()), float(np.median(depth)), float(depth.max())) if len(depth) else None,
        appearance=appearance,
    )


def document(report: CloudReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    names = ("min", "median", "max")
    return {
        "output": report.output.as_posix(),
        "points": report.points,
        "pixels": report.pixels,
        "scale": report.scale,
        "geometry": asdict(report.geometry),
        "depth_m": dict(zip(names, report.depth, strict=True)) if report.depth else None,
        "appearance": report.appearance,
    }
