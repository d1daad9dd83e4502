"""OpenCV's FileStorage files of one camera or a pair: YAML (headers %YAML:1.0 and %YAML 1.2), XML and JSON.

Read are the keys of OpenCV's own programs (calibration.cpp: camera_matrix, distortion_coefficients, image_width,
image_height; stereo_calib.cpp: M1 D1 M2 D2 in intrinsics.yml, R T in extrinsics.yml) and those that people write, such
as K and D. R and T take points of the first camera to the second: right_T_left, in the unit of the board, taken as
metres. R1 R2 P1 P2 Q follow from them and are not read. Nothing but fisheye_model tells a fisheye's four coefficients.
Source: samples/cpp/calibration.cpp, stereo_calib.cpp, tutorial_code/calib3d/camera_calibration of OpenCV.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from camcal import files
from camcal.cameras.catalogue import MODELS as LENSES
from camcal.cameras.catalogue import model_named
from camcal.cameras.lens import OPENCV as LIBRARY
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras import file_storage
from camcal.formats.cameras.record import CAMERA, LEFT, RIGHT, CameraFormat, Given, Source, camera_of, opencv_usage
from camcal.formats.cameras.values import Values
from camcal.formats.documents import Document
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT
from camcal.parsing import LARGEST

FISHEYE, OMNIDIR = "kannala_brandt4", "mei"
MODELS = ("opencv5", "opencv8", "opencv12", "opencv14", FISHEYE, OMNIDIR)
BY_COUNT = {len(model.parameter_names) - 4: name for name, model in LENSES.items() if model.opencv == LIBRARY}

# The names that camera matrix and coefficients go by, those of OpenCV's programs first.
_MATRIX = (
    "camera_matrix",
    "Camera_Matrix",
    "cameraMatrix",
    "CameraMatrix",
    "camera_Matrix",
    "intrinsic_matrix",
    "K",
    "mtx",
)
_COEFFICIENTS = (
    "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "DistCoeffs", "dist_coeffs", "distCoeff",
    "distortion_coeffs", "distortion", "D", "dist",
)  # fmt: skip
_WIDTH, _HEIGHT = (
    ("image_width", "image_Width", "imageWidth", "width"),
    ("image_height", "image_Height", "imageHeight", "height"),
)
_SIZE = ("image_size", "imageSize", "size")
_OF_PAIR = (
    ("M", "K", *(name for name in _MATRIX if name != "K")),
    ("D", *(name for name in _COEFFICIENTS if name != "D")),
)
_SIDES = ("1", "2"), ("_1", "_2"), ("_left", "_right"), ("_l", "_r"), ("Left", "Right"), ("L", "R")
_FLAGS = ("fisheye_model", "fisheye")
_RMS, _COUNT = ("avg_reprojection_error", "Avg_Reprojection_Error"), ("nframes", "nr_of_frames", "nrOfFrames")


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera, or the cameras left and right, in a file, or in a pair of intrinsics and extrinsics.

    Raises InvalidInput for what is missing or wrong, MissingSize without a size, FileError.
    """
    documents = [file_storage.parse(source.text, str(source.path)) for source in sources]
    values = list(map(Values, documents))
    lenses = next((each for each in values if _lens_keys(each)), None)
    if lenses is None:
        raise _without_lens(documents[0])
    keys = _lens_keys(lenses)
    names = (CAMERA,) if len(keys) == 1 else (LEFT, RIGHT)
    cameras = {
        name: CameraEntry(_lens(lenses, matrix, coefficients, given, xi), quality=_quality(lenses))
        for name, (matrix, coefficients), xi in zip(
            names, keys, ("xi",) if len(keys) == 1 else ("xi1", "xi2"), strict=True
        )
    }
    placed = next((each for each in values if "R" in each and "T" in each), None) if len(keys) == 2 else None
    transforms = {} if placed is None else {f"{RIGHT}{JOINT}{LEFT}": _relative_pose(placed)}
    return CameraFile(cameras, transforms, warnings=tuple(warning for each in values for warning in each.warnings))


def _lens_keys(values: Values) -> list[tuple[str, str | None]]:
    """Return the keys of camera matrix and coefficients (None: not there) of the one camera, or of both of a pair."""
    if (matrix := _first(values, _MATRIX)) is not None:
        return [(matrix, _first(values, _COEFFICIENTS))]
    for sides in _SIDES:
        pair = [[_first(values, [f"{name}{side}" for name in names]) for names in _OF_PAIR] for side in sides]
        found = [(matrix, coefficients) for matrix, coefficients in pair if matrix is not None]
        if found:
            return found
    return []


def _first(values: Values, names: Sequence[str]) -> str | None:
    return next((name for name in names if name in values and not isinstance(values.data[name], str)), None)


def _without_lens(document: Document) -> InvalidInput:
    if "R" in document and "T" in document:
        told = "holds R and T of a pair but no camera matrix: give the file with M1 D1 M2 D2, and this one with --with"
    else:
        told = "has no camera matrix: camera_matrix, K, or M1 and M2 of a pair"
    return InvalidInput(told, where=document.where)


def _lens(values: Values, matrix: str, coefficients: str | None, given: Given, xi: str) -> Camera:
    core = values.camera_matrix(matrix)
    numbers = np.zeros(0) if coefficients is None else values.numbers(coefficients)
    size = given.size(_size(values), values.document.where)
    if xi in values:
        if len(numbers) != 4:
            raise values.wrong(coefficients or xi, f"{len(numbers)} coefficients; cv2.omnidir has 4")
        return camera_of(OMNIDIR, size, core, np.concatenate([values.numbers(xi, 1), numbers]))
    if coefficients is None:
        values.warn("assumed_no_distortion", matrix, "no distortion coefficients: zero distortion assumed")
    model = _model(values, coefficients or matrix, len(numbers), given)
    return camera_of(model, size, core, numbers)


def _model(values: Values, key: str, count: int, given: Given) -> str:
    """Return the lens model: by the number of coefficients, for four of them by the file or the user."""
    flag = _first(values, _FLAGS)
    told = None if flag is None else bool(values.number(flag))
    wanted = None if given.model is None else model_named(given.model).name
    if told is None:
        told = None if wanted is None else wanted == FISHEYE
    elif wanted is not None and told != (wanted == FISHEYE):
        raise values.wrong(flag or key, f"the file says {'fisheye' if told else 'no fisheye'}, --model {given.model}")
    if told and count == 4:
        return FISHEYE
    if told or count not in BY_COUNT:
        counts = "4" if told else "4, 5, 8, 12 or 14"
        raise values.wrong(key, f"{count} coefficients; OpenCV's {'fisheye' if told else 'lenses'} have {counts}")
    if count == 4 and told is None:
        raise values.wrong(
            key, "4 coefficients are k1 k2 p1 p2, or k1 to k4 of a fisheye: give --model opencv4 or --model fisheye"
        )
    return BY_COUNT[count]


def _size(values: Values) -> tuple[int, int] | None:
    width, height = _first(values, _WIDTH), _first(values, _HEIGHT)
    if width is not None and height is not None:
        return values.side(width), values.side(height)
    if (key := _first(values, _SIZE)) is not None and isinstance(values.data[key], list):
        return values.sides(key)
    return None


def _quality(values: Values) -> Mapping[str, float]:
    rms, count = _first(values, _RMS), _first(values, _COUNT)
    found: dict[str, float] = {}
    if rms is not None and isinstance(values.data[rms], (int, float)) and 0 <= values.data[rms] <= LARGEST:
        found["rms_px"] = float(values.data[rms])
    if count is not None and type(values.data[count]) is int and values.data[count] > 0:
        found["images_used"] = values.data[count]
    return found


def _relative_pose(values: Values) -> Transform:
    rotation = values.matrix_of("R", 3, 9)
    matrix = so3.exp(rotation.ravel()) if rotation.size == 3 else values.matrix("R", 3, 3)
    return Transform(values.pose("R", matrix, values.numbers("T", 3)))


def write(path: Path, file: CameraFile) -> None:
    """Write one camera, or a pair with R and T where they are known, as the suffix says: .xml, .json, else YAML.

    Raises InvalidInput for a pair of two image sizes or of a fisheye beside another lens, FileError.
    """
    entries = list(file.cameras.values())
    cameras = [entry.camera for entry in entries]
    sizes = {camera.image_size for camera in cameras}
    kinds = {camera.model.name if camera.model.name in (FISHEYE, OMNIDIR) else "" for camera in cameras}
    if len(sizes) > 1 or len(kinds) > 1:
        what = "sizes of images" if len(sizes) > 1 else "kinds of lenses (fisheye, omnidirectional and not)"
        raise InvalidInput(
            f"OpenCV's files hold no two {what}; write the cameras one by one, FILE#NAME", where=str(path)
        )
    width, height = cameras[0].image_size
    items: dict[str, file_storage.Item] = {
        "image_width": width,
        "image_height": height,
        "fisheye_model": int(FISHEYE in kinds),
    }
    if len(cameras) == 1:
        items |= _items(cameras[0], "camera_matrix", "distortion_coefficients", "xi")
        if "rms_px" in entries[0].quality:
            items["avg_reprojection_error"] = float(entries[0].quality["rms_px"])
    else:
        for side, camera in zip("12", cameras, strict=True):
            items |= _items(camera, f"M{side}", f"D{side}", f"xi{side}")
        items |= _extrinsics(file)
    files.write_text(path, file_storage.text_of(items, path.suffix, usage(file)))


def usage(file: CameraFile) -> str:
    """Return with which of OpenCV's functions the camera is used, or the pair with R and T."""
    lens = next(iter(file.cameras.values())).camera.model
    if len(file.cameras) == 1 or lens.name == OMNIDIR:
        return opencv_usage(file)
    module = f"{LIBRARY}.fisheye" if lens.name == FISHEYE else LIBRARY
    return (
        f"use {module}.stereoRectify(M1, D1, M2, D2, size, R, T); R, T take points of the first camera to the second, m"
    )


def _items(camera: Camera, matrix: str, coefficients: str, xi: str) -> dict[str, file_storage.Item]:
    if camera.model.name == OMNIDIR:
        return {matrix: camera.K, xi: np.array([[camera.value("xi")]]), coefficients: camera.parameters[5:][None]}
    return {matrix: camera.K, coefficients: camera.dist[None]}


def _extrinsics(file: CameraFile) -> dict[str, file_storage.Item]:
    first, second = file.cameras
    pose = pose_between(file, second, first)
    return {} if pose is None else {"R": np.array(pose.rotation), "T": np.array(pose.translation)[:, None]}


OPENCV = CameraFormat(
    name="opencv",
    title="OpenCV FileStorage",
    suffixes=(".yml", ".yaml", ".xml", ".json"),
    models=MODELS,
    read=read,
    write=write,
    usage=usage,
    most_cameras=2,
    keeps=frozenset({"rms"}),
    files=2,
)
