"""What a camera format is: what it can hold, how its files are distinguished from others, read and written."""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import MODELS
from camcal.cameras.lens import FISHEYE, OPENCV
from camcal.cameras.model import Camera
from camcal.cameras.validity import valid_block
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraFile
from camcal.formats.cameras.lenses import Lenses
from camcal.formats.native import NAME
from camcal.geometry.pose import JOINT

CAMERA, LEFT, RIGHT = "camera", "left", "right"  # names of cameras whose file gives none
EVERY_LENS = tuple(MODELS)  # of a format that has any lens, or none
ANY_FRAME = frozenset({"*"})


class MissingSize(InvalidInput):
    """A camera file without the size of its images."""


class Source(NamedTuple):
    """A file and its text; of a binary file its bytes as Latin-1."""

    path: Path
    text: str
    binary: bool = False


@dataclass(frozen=True)
class Given:
    """What the user gives if the file lacks it: the size (width, height) of its images, its lens model."""

    image_size: tuple[int, int] | None = None
    model: str | None = None

    def size(self, known: tuple[int, int] | None, where: str) -> tuple[int, int]:
        """Return the size of the images, which the file may know.

        Raises MissingSize if neither says it, InvalidInput if they differ.
        """
        if known is None and self.image_size is None:
            advice = f"give --size WxH, or 'camcal convert {where} camera.yaml --size WxH' first"
            raise MissingSize(f"has no image size: {advice}", where=where)
        if known is not None and self.image_size not in (None, known):
            raise InvalidInput(
                "the file is for {}x{} images, not for {}x{}".format(*known, *self.image_size), where=where
            )
        return known or self.image_size or (0, 0)


def _same_path(path: Path, _file: CameraFile) -> tuple[Path, ...]:
    return (path,)


@dataclass(frozen=True)
class CameraFormat:
    """A format of camera files.

    title: its name in words. suffixes: of the files it writes, the usual one first. models: the lens models that it
    writes, the simplest of each family first. most_cameras: None for any number. keeps: what it holds beyond lenses,
    sizes of images and transforms between cameras, by the names that `left_out` gives it. frames: which others than
    cameras its transforms may have, ANY_FRAME for all. files: how many may belong together as IN and --with. read: the
    cameras in so many files. write: writes cameras whose lens models are of `models`; outputs: the files that this
    writes. usage: with which functions such a file is used. in_folder: whether a path without a suffix is a folder with
    a file for each camera. lenses: how its lenses are written, where that is declared. poses: which transforms it has,
    in words. note: what who uses such a file has to know. By which text a file is known says `recognition`.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    models: tuple[str, ...]
    read: Callable[[Sequence[Source], Given], CameraFile]
    write: Callable[[Path, CameraFile], None]
    outputs: Callable[[Path, CameraFile], tuple[Path, ...]] = _same_path
    usage: Callable[[CameraFile], str] | None = None
    lenses: Lenses | None = None
    poses: str = ""
    note: str = ""
    most_cameras: int | None = None
    keeps: frozenset[str] = frozenset()
    frames: frozenset[str] = frozenset()
    files: int = 1
    in_folder: bool = False
    is_library: bool = False


def read_only(program: str) -> Callable[[Path, CameraFile], None]:
    """Return what refuses to write files of a program, with InvalidInput."""

    def refuse(path: Path, _file: CameraFile) -> NoReturn:
        raise InvalidInput(f"{program}'s files are read, not written", where=str(path))

    return refuse


def write_only(program: str) -> Callable[[Sequence[Source], Given], CameraFile]:
    """Return what refuses to read files of a program, with InvalidInput."""

    def refuse(sources: Sequence[Source], _given: Given) -> NoReturn:
        raise InvalidInput(f"{program}: written, not read", where=str(sources[0].path))

    return refuse


def opencv_usage(file: CameraFile) -> str:
    """Return with which of OpenCV's functions the cameras of a file are used: those of a fisheye are others."""
    models = {entry.camera.model.name for entry in file.cameras.values()}
    if "mei" in models:
        how = "undistortImage(image, K, D, xi, cv2.omnidir.RECTIFY_PERSPECTIVE, Knew=K)"
        return f"omnidirectional: use cv2.omnidir.{how}, not {OPENCV}.undistort"
    if any(entry.camera.model.opencv == FISHEYE for entry in file.cameras.values()):
        angles = (valid_block(entry.camera, entry.image_circle)["max_theta_deg"] for entry in file.cameras.values())
        far = "; its projections are wrong beyond 90 deg from the axis" if max(angles) > 90 else ""
        return f"fisheye: use {FISHEYE}.undistortImage(image, K, D, Knew=K), not {OPENCV}.undistort{far}"
    return f"use {OPENCV}.undistort(image, K, D)"


def expressed(camera: Camera, models: Sequence[str]) -> Camera | None:
    """Return the camera in its own lens model, or the first of these that it is exactly, None if there is none.

    Within a family of models the same name is the same coefficient, and one that is 0 may as well not be there.
    """
    if models is EVERY_LENS or camera.model.name in models:
        return camera
    values = dict(zip(camera.model.parameter_names, camera.parameters.tolist(), strict=True))
    for model in (MODELS[name] for name in models):
        lost = [name for name in values if name not in model.parameter_names and values[name] != 0]
        if type(model) is type(camera.model) and not lost:
            parameters = np.array([values.get(name, 0.0) for name in model.parameter_names])
            return Camera(model, camera.image_size, parameters)
    return None


def lost_coefficients(camera: Camera, models: Sequence[str]) -> dict[str, float]:
    """Return the coefficients, by name, that are not 0 and that no model of the camera's family among these has."""
    family = [MODELS[name] for name in models if type(MODELS[name]) is type(camera.model)]
    held = {name for model in family for name in model.parameter_names}
    values = {name: camera.value(name) for name in camera.model.parameter_names}
    return {name: value for name, value in values.items() if name not in held and value != 0}


def name_of(text: str, fallback: str = CAMERA) -> str:
    """Return the name of a camera that another program calls by any text."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
    return name if NAME.match(name) and JOINT not in name else fallback


def name_of_topic(topic: str) -> str:
    """Return the name of a camera whose camera_info or images have a topic of ROS: left for /left/camera_info."""
    return name_of(topic.rpartition("/")[0])


def camera_of(
    model: str, size: tuple[int, int], core: tuple[float, float, float, float], coefficients: Array
) -> Camera:
    """Return the camera of a lens model, fx fy cx cy and the model's coefficients (N,)."""
    return Camera(MODELS[model], size, np.concatenate([core, coefficients]))
