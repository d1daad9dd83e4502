"""Two cameras of a rig file that are not rectified yet: how their images are, and what is known of the result."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from pathlib import Path

from camcal.arrays import Array, BoolArray, PixelArray
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError, InvalidInput
from camcal.formats.camera_file import CameraFile, pair_covariance
from camcal.geometry.frame_graph import FrameGraph
from camcal.geometry.pose import NamedTransform, frames_of
from camcal.images.remap import Maps, build_maps
from camcal.progress import SILENT, Progress
from camcal.run.paths import split_address
from camcal.stereo.geometry import of_rectification, why_not_rectified
from camcal.stereo.points.calibration_error import CalibratedPair, calibration_error
from camcal.stereo.rectify.options import RectifiedViewOptions
from camcal.stereo.rectify.plan import DEFAULTS, plan_rectification
from camcal.stereo.rectify.record import Rectification
from camcal.tasks.given_camera import Size, read_camera_file
from camcal.tasks.options import CAMERA_SUFFIXES, GivenCamera
from camcal.tasks.stereo.rectified_pair import RectifiedPair


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera, and what its lens lights of the image, None for all of it or where it is not known."""

    camera: Camera
    circle: ImageCircle | None = None


@dataclass(frozen=True, eq=False)
class RigPair:
    """Two cameras and how their images are rectified.

    left, right: in the order of the rectification, which exchanges cameras that stand the other way round. known: of
    the rectified pair.
    """

    left: Lens
    right: Lens
    rectification: Rectification
    known: RectifiedPair

    @cached_property
    def maps(self) -> tuple[Maps, Maps]:
        """The maps from the images of the left and the right camera to the rectified ones; made when first needed."""
        rectified = self.rectification
        sides = (
            (self.left, rectified.left_camera, rectified.rect_R_left),
            (self.right, rectified.right_camera, rectified.rect_R_right),
        )
        left, right = (build_maps(lens.camera, view, "linear", turn.T, lens.circle) for lens, view, turn in sides)
        return left, right

    def in_order(self, pair: Sequence[Path]) -> tuple[Path, Path]:
        """Return the images of the left and the right camera of a pair as it was given, in the order of the rig."""
        first, second = pair
        return (second, first) if self.rectification.swapped else (first, second)

    def rectified(self, left: Array, right: Array) -> tuple[PixelArray, PixelArray]:
        """Return the rectified images of the left and the right camera's.

        Raises InvalidInput for images of another size than the camera's.
        """
        return self.maps[0].apply(left), self.maps[1].apply(right)

    @property
    def valid(self) -> tuple[BoolArray, BoolArray]:
        """The masks (H, W) of what the left and the right rectified image show."""
        return self.maps[0].valid(), self.maps[1].valid()


def rig_pair_of(
    address: str | None,
    camera: str | None,
    size_of_images: Callable[[], Size | None],
    view: RectifiedViewOptions = DEFAULTS,
    progress: Progress = SILENT,
    *,
    even_rectified: bool = False,
) -> RigPair | None:
    """Return two cameras of a camera file that are no rectified pair and how they are rectified.

    address: FILE, FILE#LEFT, or FILE#LEFT,RIGHT where it has several pairs; camera: the same in place of what follows
    the #. size_of_images: asked where the file says none. view: what the rectified images show. None if the file is not
    of two cameras joined by transforms, or if they are a rectified pair, unless
    even_rectified.
    Raises InvalidInput for cameras that are not there or remain to be chosen, and what cannot be rectified; FileError.
    """
    if address is None:
        return None
    path, named = split_address(address)
    if path.suffix.lower() not in CAMERA_SUFFIXES:
        return None
    file = read_camera_file(str(path), GivenCamera(), progress, size_of_images)
    graph = FrameGraph([NamedTransform(*frames_of(name), item.pose) for name, item in file.transforms.items()])
    names = _chosen(file, graph, camera or named, address)
    if names is None:
        return None
    first, second = (file.cameras[name].camera for name in names)
    second_T_first = graph.along(graph.path(names[1], names[0])).pose
    if not even_rectified and why_not_rectified(first, second, second_T_first) is None:
        return None
    circles = {name: file.cameras[name].image_circle for name in names}
    try:
        rectification = plan_rectification(
            dict(zip(names, (first, second), strict=True)), second_T_first, view, circles
        )
    except CamcalError as error:
        raise type(error)(error.message, where=error.where or address) from error
    return _rig_pair(file, graph, rectification)


def _chosen(file: CameraFile, graph: FrameGraph, wanted: str | None, address: str) -> tuple[str, str] | None:
    """Return the names of two cameras, None if no transforms join any two."""
    joined = [pair for pair in permutations(file.cameras, 2) if _are_joined(graph, pair)]
    if not joined:
        return None
    first, _, second = (wanted or "").partition(",")
    for name in filter(None, (first, second)):
        if name not in file.cameras:
            raise InvalidInput(f"no camera {name!r}; there are {', '.join(file.cameras)}", where=address)
    fitting = [pair for pair in joined if first in ("", pair[0]) and second in ("", pair[1])]
    if not first and len(file.cameras) == 2:
        return fitting[0]
    if len(fitting) != 1:
        raise InvalidInput(
            f"{len(file.cameras)} cameras; name the two: {split_address(address)[0]}#{','.join(joined[0])}",
            where=address,
        )
    return fitting[0]


def _are_joined(graph: FrameGraph, pair: tuple[str, str]) -> bool:
    try:
        graph.path(*pair)
    except InvalidInput:
        return False
    return True


def _rig_pair(file: CameraFile, graph: FrameGraph, rectification: Rectification) -> RigPair:
    """Return the pair in the order of its rectification, with what the covariance of the file means for it."""
    names = rectification.left, rectification.right
    left, right = (Lens(file.cameras[name].camera, file.cameras[name].image_circle) for name in names)
    right_T_left = graph.along(graph.path(names[1], names[0]))
    geometry = of_rectification(rectification)
    covariance = pair_covariance(file, *names)
    calibration = None
    if covariance.any():
        turns = rectification.rect_R_left, rectification.rect_R_right
        pair = CalibratedPair(left.camera, right.camera, right_T_left.pose, covariance, *turns)
        calibration = calibration_error(pair, geometry, rectification.size)
    return RigPair(left, right, rectification, RectifiedPair(geometry, {}, calibration, rectification.rect_R_left.T))
