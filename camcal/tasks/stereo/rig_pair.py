"""Two cameras of a rig file and their images: how they are rectified, read and matched."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import permutations
from math import floor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from camcal import files
from camcal.arrays import Array, PixelArray
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import provenance, split_address
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
from camcal.images.files import load
from camcal.messages import Message
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress
from camcal.raw.tiles import one_by_one
from camcal.run.process import keep_freed_memory, over_threads
from camcal.stereo.depth_error import CalibratedPair, calibration_error
from camcal.stereo.disparity import Confidence, Disparity, of_rectification, too_few, why_not_rectified
from camcal.stereo.matching.learned import learned_disparity
from camcal.stereo.matching.match import match_prepared, within
from camcal.stereo.matching.preparation import Masks, prepare
from camcal.stereo.options import BEST, MatchOptions, RectifiedViewOptions
from camcal.stereo.rectify.plan import DEFAULTS, PairMaps, build_pair_maps, plan_rectification
from camcal.stereo.rectify.record import Rectification, rectified_covariance
from camcal.tasks.given_camera import Size, read_camera_file, view_outside_region
from camcal.tasks.options import CAMERA_SUFFIXES, GivenCamera, ImagePart
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
    address: str | None, camera: str | None, size_of_images: Callable[[], Size | None], part: ImagePart
) -> RigPair | None:
    """Return two cameras of a camera file that are no rectified pair and how they are rectified.

    address: FILE, FILE#LEFT, or FILE#LEFT,RIGHT where it has several pairs; camera: the same in place of what follows
    the #. size_of_images: asked where the file says none. part: of the cameras' images, that these are. None if no
    transform joins two cameras of the file, or if they are a rectified pair.
    Raises InvalidInput for cameras that are not there or remain to be chosen, and what cannot be rectified; FileError.
    """
    rig = _unrectified(address, camera, size_of_images, part)
    return None if rig is None else rig_pair(rig, rig.rectification())


def require_rectified(address: str | None, camera: str | None, size: Size, part: ImagePart) -> None:
    """Raise InvalidInput if the camera file of a disparity map is of two cameras that are no rectified pair.

    address, camera, part: as in `unrectified_pair`. size: of the map, (width, height).
    """
    rig = _unrectified(address, camera, lambda: size, part)
    if rig is not None:
        advice = "a disparity map needs the camera file of the rectified pair, or none if it has a sidecar"
        raise InvalidInput(f"{rig.why_not_rectified}; {advice}", where=address)


def _unrectified(
    address: str | None, camera: str | None, size_of_images: Callable[[], Size | None], part: ImagePart
) -> GivenRig | None:
    if address is None:
        return None
    path, named = split_address(address)
    if path.suffix.lower() not in CAMERA_SUFFIXES:
        return None
    given = GivenCamera(part=part)
    rig = _choose(read_camera_file(str(path), given, SILENT, size_of_images), _names(camera or named), path)
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


_ADVICE = "an unrectified pair needs a rig file: camcal stereo calibrate LEFT RIGHT --board BOARD -o rig.yaml"
_BEHIND = 4  # pixels behind what is infinitely far, so that its matches are not at the end of the range
_UNRECTIFIED = ("rows_not_aligned", "swapped_images")  # failures that a rig file may mend


@dataclass(frozen=True, eq=False)
class PairImages:
    """The rectified images (H, W[, C]) of a pair and what is known of it.

    paths: of the left and the right image, in the order of the pair. image: the file of the rectified left image, None
    if it was rectified here. valid: masks of what they show, None for all of it.
    """

    paths: tuple[Path, Path]
    left: PixelArray
    right: PixelArray
    known: RectifiedPair
    image: Path | None = None
    valid: Masks | None = None


def read_pair(
    paths: Sequence[Path],
    rig: RigPair | None,
    known_of: Callable[[tuple[int, int]], RectifiedPair] = lambda _size: RectifiedPair(None),
) -> PairImages:
    """Return the images of a pair, rectified if a rig is given; else known_of tells what is known for their size.

    Raises InvalidInput for images of another size than the cameras', FileError.
    """
    if rig is None:
        left, right = (load(path).pixels for path in paths)
        return PairImages((paths[0], paths[1]), left, right, known_of((left.shape[1], left.shape[0])), paths[0])
    ordered = rig.in_order(paths)
    return rectified_pair(ordered, load(ordered[0]).pixels, load(ordered[1]).pixels, rig)


def rectified_pair(paths: tuple[Path, Path], left: PixelArray, right: PixelArray, rig: RigPair) -> PairImages:
    """Return a pair rectified, its images in the order of the rectification; raises InvalidInput as `read_pair`."""
    images = []
    for path, pixels, maps in zip(paths, (left, right), (rig.maps.left, rig.maps.right), strict=True):
        try:
            images.append(maps.apply(pixels))
        except InvalidInput as error:
            raise InvalidInput(error.message, where=error.where or str(path)) from error
    return PairImages(paths, images[0], images[1], rig.known, valid=rig.maps.valid)


class Matched(NamedTuple):
    """A map, by how much the rows were aligned (px RMS), how many pixels show something, its warnings and failures."""

    disparity: Disparity
    rows: float
    pixels: int
    warnings: tuple[Message, ...]
    failures: tuple[Message, ...]


def match_images(
    images: PairImages, matching: MatchOptions, model: Path | None = None, jobs: int | None = 1
) -> Matched:
    """Return the disparity of the left image; jobs: threads for one pair. model: a network in place of the matchers.

    Of a pair above each other the images are matched on their side, and the map is upright again.
    """
    keep_freed_memory()
    left, right, valid, geometry = images.left, images.right, images.valid, images.known.geometry
    upright = geometry is not None and geometry.upright
    if upright:
        left, right = (_transposed(image) for image in (left, right))
        valid = valid and (_transposed(valid[0]), _transposed(valid[1]))
    pixels = int(np.count_nonzero(valid[0])) if valid else left.shape[0] * left.shape[1]
    if model is not None:
        found = Matched(_by_network(left, right, model), 0.0, pixels, (), ())
    else:
        found = _match(left, right, matching, jobs, images)
    disparity = found.disparity
    if valid is not None:
        # that the range ends at what is infinitely far is no fault of the range
        disparity = replace(within(disparity, valid), at_ends=(0.0, disparity.at_ends[1]))
    if model is None:
        share = np.count_nonzero(disparity.confidence > Confidence.FILLED) / max(pixels, 1)
        found = found._replace(failures=found.failures + too_few(float(share), by_rig=images.valid is not None))
    if upright:
        parts = (disparity.values, disparity.sigma, disparity.confidence)
        values, sigma, confidence = (_transposed(part) for part in parts)
        disparity = replace(disparity, values=values, sigma=sigma, confidence=confidence)
    return found._replace(disparity=disparity, pixels=pixels)


def _transposed(image: Array) -> Array:
    return np.ascontiguousarray(image.swapaxes(0, 1))


def _match(left: Array, right: Array, matching: MatchOptions, jobs: int | None, images: PairImages) -> Matched:
    prepared = prepare(
        left,
        right,
        matching.search,
        align=matching.align_rows,
        expose=matching.expose_alike,
        farthest=images.known.farthest,
    )
    if images.valid is not None and matching.search is None:
        # the range ends at what is infinitely far: in images rectified here nothing is behind the cameras
        first = max(prepared.first, floor(images.known.farthest) - _BEHIND)
        prepared = replace(prepared, first=first, count=max(prepared.first + prepared.count - first, _BEHIND))
    if jobs != 1 and matching.quality == BEST:
        with over_threads(jobs) as each:
            disparity = match_prepared(prepared, matching, each)
    else:
        disparity = match_prepared(prepared, matching, one_by_one)
    failures = prepared.failures if images.known.geometry else tuple(map(_with_advice, prepared.failures))
    return Matched(disparity, prepared.rows, 0, prepared.warnings, failures)


def _with_advice(failure: Message) -> Message:
    """Return a failure of images without a camera file with what to do if they were never rectified."""
    return replace(failure, text=f"{failure.text}; {_ADVICE}") if failure.code in _UNRECTIFIED else failure


def _by_network(left: Array, right: Array, model: Path) -> Disparity:
    values = learned_disparity(left, right, model)
    known = np.isfinite(values)
    confidence = np.where(known, Confidence.SINGLE, Confidence.NONE)
    ends = (int(np.floor(values[known].min())), int(np.ceil(values[known].max()))) if known.any() else (0, 0)
    return Disparity(values, np.full_like(values, np.nan), confidence, ends)
