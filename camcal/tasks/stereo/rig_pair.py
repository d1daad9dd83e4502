"""Two cameras of a rig file: which ones, how their images are rectified, and what is known of the rectified pair."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from pathlib import Path

import numpy as np

from camcal import files
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import provenance
from camcal.formats.camera_file import (
    STEP,
    CameraEntry,
    CameraFile,
    JointCovariance,
    Transform,
    pair_covariance,
    pose_between,
    verdict_of_view,
)
from camcal.geometry.pose import JOINT, Pose
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress
from camcal.run.paths import split_address
from camcal.stereo.geometry import of_rectification, why_not_rectified
from camcal.stereo.points.calibration_error import CalibratedPair, calibration_error
from camcal.stereo.rectify.options import RectifiedViewOptions
from camcal.stereo.rectify.plan import DEFAULTS, PairMaps, build_pair_maps, plan_rectification
from camcal.stereo.rectify.record import Rectification, rectified_covariance
from camcal.tasks.given_camera import Size, read_camera_file, view_outside_region
from camcal.tasks.options import CAMERA_SUFFIXES, GivenCamera
from camcal.tasks.stereo.rectified_pair import RectifiedPair

_AS_FILE = GivenCamera()
_NEEDED = (
    "is no rig: a file with two cameras and the transform between them is needed, as 'camcal stereo calibrate LEFT "
    "RIGHT --board BOARD -o rig.yaml' writes it"
)


@dataclass(frozen=True, eq=False)
class GivenRig:
    """Two cameras of a file, in the order of the images, and second_T_first (m)."""

    path: Path
    file: CameraFile
    names: tuple[str, str]
    second_T_first: Pose

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """Both by their names."""
        return {name: self.file.cameras[name].camera for name in self.names}

    @property
    def circles(self) -> Mapping[str, ImageCircle | None]:
        """What their lenses light of the images, None for all of it or where it is not known."""
        return {name: self.file.cameras[name].image_circle for name in self.names}

    @property
    def why_not_rectified(self) -> str | None:
        """Why the images of the two are no rectified pair, None if they are one."""
        first, second = (self.cameras[name] for name in self.names)
        return why_not_rectified(first, second, self.second_T_first)

    def pose(self, target: str, source: str) -> Pose:
        """Return target_T_source of the two."""
        return self.second_T_first if source == self.names[0] != target else self.second_T_first.inverse()

    def rectification(self, view: RectifiedViewOptions = DEFAULTS) -> Rectification:
        """Return how the two are rectified; raises as `plan_rectification` does, naming the file."""
        try:
            found = plan_rectification(self.cameras, self.second_T_first, view, self.circles)
        except CamcalError as error:
            raise type(error)(error.message, where=error.where or str(self.path)) from error
        views = (
            (found.left, found.left_camera, found.rect_R_left),
            (found.right, found.right_camera, found.rect_R_right),
        )
        outside = [
            message
            for name, shown, turn in views
            for message in view_outside_region(
                self.file.cameras[name].verdict, self.cameras[name], shown, f"{self.path}#{name}", turn
            )
        ]
        return replace(found, warnings=(*found.warnings, *outside))


@dataclass(frozen=True, eq=False)
class RigPair:
    """Two cameras by their names, and how their images are rectified; without the file, for worker processes.

    circles: as of GivenRig. known: of the rectified pair.
    """

    cameras: Mapping[str, Camera]
    circles: Mapping[str, ImageCircle | None]
    rectification: Rectification
    known: RectifiedPair

    @cached_property
    def maps(self) -> PairMaps:
        """The maps from the images of the left and the right camera to the rectified ones; made when first needed."""
        return build_pair_maps(self.cameras, self.rectification, circles=self.circles)

    def in_order(self, pair: Sequence[Path]) -> tuple[Path, Path]:
        """Return the images of the left and the right camera of a pair as it was given, in the order of the rig."""
        first, second = pair
        return (second, first) if self.rectification.swapped else (first, second)


def read_rig(
    address: str,
    wanted: tuple[str, ...] | None,
    size_of_images: Callable[[], Size | None],
    second: Path | None = None,
    given: GivenCamera = _AS_FILE,
    progress: Progress = SILENT,
) -> GivenRig:
    """Return two cameras of a rig file, FILE or FILE#LEFT,RIGHT.

    wanted: their names, in the order of the images; None for the only two. size_of_images: asked where the file says
    none. second: the other file of a rig that is written as two. given: the lens model of four coefficients.
    Raises InvalidInput if it is not clear which two are meant or no transform joins them, and as `cameras.read` does.
    """
    path, named = split_address(address)
    file = read_camera_file(str(path), given, progress, size_of_images, second)
    if len(file.cameras) < 2:
        raise InvalidInput(_NEEDED, where=str(path))
    names = _names(named) if wanted is None else wanted
    found = _choose(file, names, path)
    if found is None:
        one, other = names if len(names) == 2 else tuple(file.cameras)[:2]
        raise InvalidInput(f"no transform joins {one} and {other}: {other}{JOINT}{one} is missing", where=str(path))
    return found


def unrectified_pair(
    address: str | None, camera: str | None, size_of_images: Callable[[], Size | None], progress: Progress = SILENT
) -> RigPair | None:
    """Return two cameras of a camera file that are no rectified pair and how they are rectified.

    address: FILE, FILE#LEFT, or FILE#LEFT,RIGHT where it has several pairs; camera: the same in place of what follows
    the #. size_of_images: asked where the file says none. None if no transform joins two cameras of the file, or if
    they are a rectified pair.
    Raises InvalidInput for cameras that are not there or remain to be chosen, and what cannot be rectified; FileError.
    """
    rig = _unrectified(address, camera, size_of_images, progress)
    return None if rig is None else rig_pair(rig, rig.rectification())


def require_rectified(address: str | None, camera: str | None, size: Size) -> None:
    """Raise InvalidInput if the camera file of a disparity map is of two cameras that are no rectified pair.

    address, camera: as in `unrectified_pair`. size: of the map, (width, height).
    """
    rig = _unrectified(address, camera, lambda: size, SILENT)
    if rig is not None:
        advice = "a disparity map needs the camera file of the rectified pair, or none if it has a sidecar"
        raise InvalidInput(f"{rig.why_not_rectified}; {advice}", where=address)


def _unrectified(
    address: str | None, camera: str | None, size_of_images: Callable[[], Size | None], progress: Progress
) -> GivenRig | None:
    if address is None:
        return None
    path, named = split_address(address)
    if path.suffix.lower() not in CAMERA_SUFFIXES:
        return None
    rig = _choose(read_camera_file(str(path), _AS_FILE, progress, size_of_images), _names(camera or named), path)
    return None if rig is None or rig.why_not_rectified is None else rig


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(name for name in (text or "").split(",") if name)


def _choose(file: CameraFile, wanted: tuple[str, ...], path: Path) -> GivenRig | None:
    """Return two cameras by their names, by that of the first, or the only two; None if no transforms join them."""
    for name in wanted:
        if name not in file.cameras:
            raise InvalidInput(f"no camera {name!r}{did_you_mean(name, list(file.cameras))}", where=str(path))
    poses = {(one, other): pose_between(file, other, one) for one, other in permutations(file.cameras, 2)}
    joined = {names: pose for names, pose in poses.items() if pose is not None}
    fitting = [names for names in joined if names[: len(wanted)] == wanted]
    if not joined or (len(wanted) == 2 and not fitting):
        return None
    if len(fitting) != 1 and (wanted or len(file.cameras) > 2):
        cameras = f"holds {len(file.cameras)} cameras ({', '.join(file.cameras)})"
        raise InvalidInput(f"{cameras}; name two: {path}#{','.join((fitting or list(joined))[0])}", where=str(path))
    return GivenRig(path, file, fitting[0], joined[fitting[0]])


def rig_pair(rig: GivenRig, rectification: Rectification) -> RigPair:
    """Return two cameras as they are rectified, with what the covariance of their file means for the depth.

    Raises InvalidInput if that determines no depth.
    """
    found = rectification
    geometry = of_rectification(found)
    covariance = pair_covariance(rig.file, found.left, found.right)
    calibration = None
    if covariance.any():
        left, right = rig.cameras[found.left], rig.cameras[found.right]
        turns = found.rect_R_left, found.rect_R_right
        pair = CalibratedPair(left, right, rig.pose(found.right, found.left), covariance, *turns)
        calibration = calibration_error(pair, geometry, found.size)
    return RigPair(rig.cameras, rig.circles, found, RectifiedPair(geometry, {}, calibration, found.rect_R_left.T))


def rectified_file(rig: GivenRig, rectification: Rectification, command: Sequence[str]) -> CameraFile:
    """Return the file of the rectified cameras, with the verdicts on their lenses and the covariance of the rig.

    command: the words that the file records.
    """
    found = rectification
    origin = {"file": rig.path.as_posix(), "sha256": files.sha256(rig.path), "cameras": list(rig.names)}
    block = provenance.build(command, None) | {"rig": origin}
    views = {found.left: found.left_camera, found.right: found.right_camera}
    name, pose = f"{found.right}{JOINT}{found.left}", found.right_T_left
    joint = _covariance(rig, found, views, name)
    if joint is None:
        transform = Transform(pose)
    else:
        views = {
            own: Camera(view.model, view.image_size, view.parameters, joint.matrix[part, part])
            for (own, view), part in zip(views.items(), (slice(0, 4), slice(4, 8)), strict=True)
        }
        transform = Transform(pose, joint.matrix[8:, 8:])
    entries = {
        own: CameraEntry(view, verdict=verdict_of_view(rig.file.cameras[own].verdict)) for own, view in views.items()
    }
    return CameraFile(entries, {name: transform}, joint, provenance=block)


def _covariance(
    rig: GivenRig, found: Rectification, views: Mapping[str, Camera], transform: str
) -> JointCovariance | None:
    """Return the covariance of the rectified cameras and of their transform, None where the rig's is not known."""
    known = pair_covariance(rig.file, found.left, found.right)
    sources = [rig.cameras[name] for name in views]
    counts = np.cumsum([len(source.parameters) for source in sources])
    blocks = np.split(np.diag(known), counts)
    matrix = rectified_covariance(found, sources[0], sources[1], known) if all(each.any() for each in blocks) else None
    if matrix is None:
        return None
    names = tuple(f"{name}.{each}" for name, view in views.items() for each in view.model.parameter_names)
    return JointCovariance((*names, *(f"{transform}.{step}" for step in STEP)), matrix)
