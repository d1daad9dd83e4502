"""The geometry of a rectified pair: from options, a camera file, or the sidecar of a map.

The other files that a sidecar names become the image that points are made of.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import FloatArray
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field
from camcal.errors import FileError, InvalidInput
from camcal.formats import cameras, disparity, disparity_sidecar, pair_calibration, split_address
from camcal.formats.camera_file import CameraFile, Transform, pair_covariance
from camcal.formats.cameras.record import MissingSize
from camcal.formats.disparity import DisparityMap
from camcal.formats.disparity_sidecar import Sidecar
from camcal.images.files import load
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.stereo.depth import StereoImage
from camcal.stereo.depth_error import CalibratedPair, CalibrationError, calibration_error
from camcal.stereo.disparity import StereoGeometry, of_pair, pinhole_intrinsics
from camcal.tasks.given_camera import read_camera_file, require_no_image, require_whole
from camcal.tasks.options import CAMERA_SUFFIXES, GivenCamera, ImagePart
from camcal.tasks.stereo.options import GeometryOptions

SUFFIXES = (*CAMERA_SUFFIXES, pair_calibration.SUFFIX)  # of files that know cameras

_NEEDED = ("fx", "cx", "cy", "baseline")


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """What is known of a rectified pair.

    geometry: None if nothing is. relative_sigma: standard deviations of fx and baseline as shares, where known.
    calibration: what the covariance of the whole calibration adds to the uncertainty of the depth, in their place.
    camera_R_rectified: (3, 3), from the rectified to the real left camera.
    """

    geometry: StereoGeometry | None
    relative_sigma: Mapping[str, float] = field(default_factory=dict)
    calibration: CalibrationError | None = None
    camera_R_rectified: FloatArray | None = None

    @property
    def farthest(self) -> float:
        """The disparity of what is infinitely far, pixels; 0 if nothing is known."""
        return -self.geometry.doffs if self.geometry else 0.0

    @property
    def calibration_error(self) -> CalibrationError | None:
        """What the calibration adds to the uncertainty of the depth, None where nothing is known of it."""
        if self.calibration is None and self.sigma_of_product:
            return CalibrationError.of_share(self.sigma_of_product)
        return self.calibration

    @property
    def sigma_of_product(self) -> float:
        """The standard deviation of fx times baseline as a share of it; what is not known counts as exact."""
        return float(np.hypot(self.relative_sigma.get("fx", 0.0), self.relative_sigma.get("baseline", 0.0)))


@dataclass(frozen=True)
class _Source:
    """The fields of a StereoGeometry and relative standard deviations that one source knows, by name.

    calibration: as in RectifiedPair, of these numbers alone.
    """

    numbers: Mapping[str, Any] = field(default_factory=dict)
    sigma: Mapping[str, float] = field(default_factory=dict)
    calibration: CalibrationError | None = None


def geometry_of(
    options: GeometryOptions,
    address: str | None,
    size: tuple[int, int],
    sidecar: Sidecar | None = None,
    progress: Progress = SILENT,
) -> StereoGeometry | None:
    """Return the geometry of a pair; see `pair_of`."""
    return pair_of(options, address, size, sidecar, progress).geometry


def pair_of(
    options: GeometryOptions,
    address: str | None,
    size: tuple[int, int],
    sidecar: Sidecar | None = None,
    progress: Progress = SILENT,
) -> RectifiedPair:
    """Return what is known of a pair: options come before the camera file, and that before the sidecar.

    address: FILE or FILE#NAME, a camera file or the calib.txt of Middlebury or KITTI. size: (width, height) of the
    left image, pixels.
    Raises InvalidInput if only a part is known, the file is of a pair that is not rectified or of images of another
    size; FileError.
    """
    _require_size(options.given.size, size, "--size")
    sources = [_of_sidecar(sidecar), _of_file(address, options, size, progress), _Source(options.numbers())]
    numbers: dict[str, Any] = {}
    sigma: dict[str, float] = {}
    for source in sources:
        sigma = {name: value for name, value in sigma.items() if name not in source.numbers} | dict(source.sigma)
        numbers |= source.numbers
    if not numbers:
        return RectifiedPair(None)
    missing = [f"--{name}" for name in _NEEDED if name not in numbers]
    if missing:
        told = "the camera file has no camera to the right of it: " if address else ""
        raise InvalidInput(f"{told}give {', '.join(missing)}, or a camera file of the rectified pair")
    geometry = StereoGeometry(**{"fy": numbers["fx"], **numbers})
    whole = [source for source in sources if source.calibration and StereoGeometry(**source.numbers) == geometry]
    calibration = whole[-1].calibration if whole else None
    return RectifiedPair(geometry, sigma, calibration, None if sidecar is None else sidecar.camera_R_rectified)


def warn_of_file(address: str | None, progress: Progress) -> None:
    """Give the warnings of a pair's camera file, for commands that ask for the geometry of every pair again.

    address: as in `pair_of`. Raises InvalidInput and FileError as `cameras.read` does.
    """
    path = None if address is None else split_address(address)[0]
    if path is not None and path.suffix.lower() != pair_calibration.SUFFIX:
        require_no_image(path)
        with suppress(MissingSize):  # the images have one
            cameras.read(path, progress)


def _of_sidecar(sidecar: Sidecar | None) -> _Source:
    if sidecar is None or sidecar.geometry is None:
        return _Source()
    return _Source(asdict(sidecar.geometry), sidecar.relative_sigma or {}, sidecar.calibration)


def _of_file(address: str | None, options: GeometryOptions, size: tuple[int, int], progress: Progress) -> _Source:
    camera, part = options.camera, options.given.part
    if address is None:
        if camera is not None:
            raise InvalidInput(f"camera {camera!r} is one of a camera file, and none is given")
        return _Source()
    path, named = split_address(address)
    if path.suffix.lower() == pair_calibration.SUFFIX:
        require_whole(part, f"a camera file, not with {path.name}")
        known = pair_calibration.read(path, camera or named)
        _require_size(known.image_size, size, address)
        return _Source(asdict(known.geometry))
    return _of_camera_file(path, camera or named, size, address, progress, part)


def _of_camera_file(
    path: Path, name: str | None, size: tuple[int, int], address: str, progress: Progress, part: ImagePart
) -> _Source:
    """Return what a camera file says of the pair: all of it, or fx, fy, cx, cy where it holds a single camera."""
    file = read_camera_file(str(path), GivenCamera(part=part), progress, lambda: size)
    pair = _pair(file, name)
    left = file.cameras[pair[0]].camera if pair else cameras.select(file, name, str(path)).camera
    _require_size(left.image_size, size, address)
    try:
        if pair is None:
            return _Source(dict(zip(("fx", "fy", "cx", "cy"), pinhole_intrinsics(left), strict=True)), _sigma(left))
        right_T_left = pair[2]
        geometry = of_pair(left, file.cameras[pair[1]].camera, right_T_left.pose)
        return _Source(asdict(geometry), _sigma(left, right_T_left), _calibration(file, pair, geometry))
    except InvalidInput as error:
        raise InvalidInput(error.message, where=address) from error


def _calibration(
    file: CameraFile, names: tuple[str, str, Transform], geometry: StereoGeometry
) -> CalibrationError | None:
    """Return what the joint covariance of a rectified pair's file means for the depth, None without one.

    Standard deviations alone do not say it: the centres of the images and the angles between the cameras are
    correlated, and their errors cancel for the most part.
    """
    left, right, right_T_left = names
    if file.joint_covariance is None:
        return None
    covariance = pair_covariance(file, left, right)
    if not covariance.any():
        return None
    first, second = file.cameras[left].camera, file.cameras[right].camera
    pair = CalibratedPair(first, second, right_T_left.pose, covariance, np.eye(3), np.eye(3))
    return calibration_error(pair, geometry, first.image_size)


def _require_size(known: tuple[int, int] | None, size: tuple[int, int], address: str) -> None:
    if known is not None and known != size:
        raise InvalidInput(
            f"the camera has {known[0]} × {known[1]} pixels, the left image {size[0]} × {size[1]}", where=address
        )


def _pair(file: CameraFile, name: str | None) -> tuple[str, str, Transform] | None:
    """Return the names of the left and the right camera and right_T_left, None if no transform joins two cameras.

    name: the left camera, None for whichever stands left.
    """
    pairs = []
    for key, transform in file.transforms.items():
        a, b = key.split("_T_")
        if a in file.cameras and b in file.cameras:
            along = int(np.argmax(np.abs(transform.pose.translation[:2])))
            left_first = transform.pose.translation[along] < 0
            # The axes are parallel, so that the deviation along the baseline is the same both ways round.
            other = Transform(transform.pose.inverse(), transform.covariance)
            pairs.append((b, a, transform) if left_first else (a, b, other))
    fitting = [pair for pair in pairs if name in (None, pair[0])]
    if len(fitting) > 1:
        raise InvalidInput(f"the camera file has {len(fitting)} pairs; give the geometry by --fx --cx --cy --baseline")
    return fitting[0] if fitting else None


def _sigma(left: Camera, right_T_left: Transform | None = None) -> dict[str, float]:
    """Return the standard deviations of fx and baseline as shares of them, where they are known."""
    found = {}
    fx = left.std("fx")
    if fx is not None:
        found["fx"] = fx / float(left.parameters[0])
    if right_T_left is not None and right_T_left.covariance is not None:
        translation = right_T_left.pose.translation
        along = int(np.argmax(np.abs(translation)))
        found["baseline"] = float(np.sqrt(right_T_left.covariance[along, along]) / abs(translation[along]))
    return found


def named_file(
    path: Path | None, disparity_path: Path, progress: Progress, needed_by: str | None = None
) -> Path | None:
    """Return a file that the sidecar of a map names; None with a warning if it is not there.

    needed_by: the option that asks for it.
    Raises FileError if it is not there and an option asks for it.
    """
    if path is None or path.is_file():
        return path
    sidecar = disparity_sidecar.path_beside(disparity_path)
    told = f"{path.name} not found"
    if needed_by is not None:
        raise FileError(f"{told}, and {needed_by} needs it", where=str(sidecar))
    progress.warn(Message("missing_companion", f"{told}; not used", where=str(sidecar)))
    return None


def stereo_image(
    found: DisparityMap,
    pair: RectifiedPair,
    image: Path | None,
    sigma: Path | float | None,
    confidence: Path | None = None,
) -> StereoImage:
    """Return a map whose geometry is known, with what is to be used of the files beside it.

    image: the left one. sigma: an image of it, or one for all pixels, pixels.
    Raises InvalidInput if their sizes differ, FileError.
    """
    assert pair.geometry is not None
    return StereoImage(
        found.values,
        pair.geometry,
        signed=found.signed,
        pixels=load(image).pixels if image else None,
        sigma=disparity.read(sigma).values if isinstance(sigma, Path) else sigma,
        confidence=np.asarray(load(confidence).pixels, np.uint8) if confidence else None,
        calibration=pair.calibration_error,
    )
