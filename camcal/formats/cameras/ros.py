"""ROS camera_info YAML: one camera a file, a pair as two files, left and right.

A file has the lens (camera_matrix, distortion_model, distortion_coefficients) and how its images are rectified:
rectification_matrix R takes the camera's axes to the rectified ones, projection_matrix P = [K' | K' t] projects from
there, the right camera with its place t in the pair, metres. Of one camera R is the identity and P = [K | 0]; of a
fisheye, whose images K would not hold, P is that of the largest pinhole view without an empty pixel.
R and P of a file that is read are kept (x_ros) and written again. What is written opens in OpenCV's FileStorage, too.
Source: image_common/camera_calibration_parsers/src/parse_yml.cpp; sensor_msgs/CameraInfo.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.catalogue import MODELS as LENSES
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.formats import emit
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.cameras.record import LEFT, RIGHT, CameraFormat, Given, Source, camera_of, name_of, opencv_usage
from camcal.formats.cameras.values import Values
from camcal.formats.documents import parse_foreign
from camcal.geometry import rotation as so3
from camcal.geometry.pose import JOINT, Pose
from camcal.messages import Message

VENDOR_KEY = "x_ros"
PLUMB_BOB, RATIONAL, EQUIDISTANT = "plumb_bob", "rational_polynomial", "equidistant"
MODELS = {"opencv5": PLUMB_BOB, "opencv8": RATIONAL, "kannala_brandt4": EQUIDISTANT}

_BY_COUNT = {
    PLUMB_BOB: {0: "pinhole", 4: "opencv4", 5: "opencv5"},
    RATIONAL: {8: "opencv8", 12: "opencv12", 14: "opencv14"},
    EQUIDISTANT: {4: "kannala_brandt4"},
}
_OTHER_NAMES = {"": PLUMB_BOB, "fisheye": EQUIDISTANT}
_SAME = 1e-9  # m and pixels, to which R and P that were read still say where the right camera stands

_WIDE, _NO_BARREL = 1.0, 0.98  # half the image over fx, and the radial factor there, from which a lens is doubted
_WIDEST = np.tan(np.radians(80))  # rays farther from the axis do not count in where the view's centre lies
_SAMPLES = 9  # a side of the image
_BESIDE = 1e-3  # of the baseline, which no pair that looks along it reaches
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Rectified:
    """R (3, 3), which takes the camera's axes to the rectified ones, and P (3, 4), pixels and pixels times metres."""

    rotation: Array
    projection: Array

    @property
    def offset(self) -> Array:
        """The translation (3,), metres, by which points of the pair's rectified frame come to the camera's."""
        return np.asarray(np.linalg.solve(self.projection[:, :3], self.projection[:, 3]))

    def leaves(self, camera: Camera) -> bool:
        """Return whether R and P are those of a camera that is not rectified: R = 1, P = [K | 0]."""
        same = of_matrix(camera)
        return np.array_equal(self.rotation, same.rotation) and np.array_equal(self.projection, same.projection)

    def placed_from(self, left: "Rectified") -> Pose:
        """Return right_T_left, if this is the right camera's."""
        rotation = self.rotation.T @ left.rotation
        return Pose(rotation, self.rotation.T @ (self.offset - left.offset))


def read(sources: Sequence[Source], given: Given) -> CameraFile:
    """Return the camera of a file, or those of two files with right_T_left, metres.

    Of two the right one is the one whose P has a place in the pair. Raises InvalidInput, FileError.
    """
    values = [Values(parse_foreign(source.text, str(source.path))) for source in sources]
    entries = [entry_of(each, given) for each in values]
    warnings = tuple(warning for each in values for warning in each.warnings)
    if len(entries) == 1:
        return CameraFile({name_of(values[0].text("camera_name")): entries[0]}, warnings=warnings)
    places = [_rectified(each) for each in values]
    if None in places:
        raise InvalidInput(
            "two files are a pair by rectification_matrix and projection_matrix", where=str(sources[0].path)
        )
    offsets = [np.abs(place.offset).max() for place in places if place is not None]
    if offsets[0] > offsets[1]:
        entries, places, values = entries[::-1], places[::-1], values[::-1]
    left, right = (place for place in places if place is not None)
    if not np.abs(right.offset - left.offset).max():
        raise InvalidInput("the fourth column of P is equal in both files: not a pair", where=str(sources[1].path))
    warnings += tuple(_doubts(values[1], left, right))
    pose = right.placed_from(left)
    names = {LEFT: entries[0], RIGHT: entries[1]}
    return CameraFile(names, {f"{RIGHT}{JOINT}{LEFT}": Transform(pose)}, warnings=warnings)


def entry_of(values: Values, given: Given) -> CameraEntry:
    """Return the camera of the keys of ROS; raises InvalidInput."""
    size = values.side("image_width"), values.side("image_height")
    core = values.camera_matrix("camera_matrix")
    count = len(values.numbers("distortion_coefficients")) if "distortion_coefficients" in values else 0
    model = _model(values, count, given)
    coefficients = values.numbers("distortion_coefficients") if count else np.zeros(0)
    coefficients = coefficients[: len(LENSES[model].parameter_names) - 4]
    camera = camera_of(model, given.size(size, values.document.where), core, coefficients)
    if model in ("opencv4", "opencv5") and given.model is None:
        _doubt_plumb_bob(values, camera)
    found = _rectified(values)
    if found is None or found.leaves(camera):
        return CameraEntry(camera)
    kept = {"rectification": found.rotation.ravel().tolist(), "projection": found.projection.ravel().tolist()}
    return CameraEntry(camera, extra={VENDOR_KEY: kept})


def _doubt_plumb_bob(values: Values, camera: Camera) -> None:
    """Warn of a wide lens without barrel distortion: some drivers give a fisheye's coefficients this name."""
    fx, _, _, _, k1, k2, *others = camera.parameters.tolist()
    edge = camera.image_size[0] / 2 / fx
    if edge > _WIDE and (k1 or k2) and not any(others[2:]) and 1 + k1 * edge**2 + k2 * edge**4 > _NO_BARREL:
        what = "a lens of more than 90 degrees without barrel distortion"
        text = f"{what}: if it is a fisheye (equidistant), as some drivers call it {PLUMB_BOB}, give --model fisheye"
        values.warn("doubtful_distortion_model", "distortion_model", text)


def _model(values: Values, count: int, given: Given) -> str:
    told = values.text("distortion_model")
    if given.model is not None and model_named(given.model).name == "kannala_brandt4" and count in (4, 5):
        if count == 5 and values.numbers("distortion_coefficients")[4]:
            raise values.wrong("distortion_coefficients", "5 coefficients; a fisheye has 4")
        return "kannala_brandt4"
    if not told and count:
        text = f"no distortion_model: {PLUMB_BOB if count < 8 else RATIONAL} assumed"
        values.warn("assumed_distortion_model", "distortion_coefficients", text)
    name = _OTHER_NAMES.get(told, told)
    if not told and count >= 8:
        name = RATIONAL
    if name not in _BY_COUNT:
        raise values.wrong("distortion_model", f"{told!r} is not one of {', '.join(_BY_COUNT)}")
    counts = _BY_COUNT[name]
    if count not in counts:
        needed = " or ".join(map(str, counts))
        raise values.wrong("distortion_coefficients", f"{count} numbers; {name} has {needed}")
    return counts[count]


def _rectified(values: Values) -> Rectified | None:
    """Return R and P, None without them."""
    if "rectification_matrix" not in values or "projection_matrix" not in values:
        return None
    rotation = values.matrix("rectification_matrix", 3, 3)
    projection = values.matrix("projection_matrix", 3, 4)
    if not (projection[0, 0] > 0 and projection[1, 1] > 0):
        return None  # an uncalibrated camera has zeros there
    pose = values.pose("rectification_matrix", rotation, np.zeros(3))
    return Rectified(np.array(pose.rotation), projection)


def _doubts(right: Values, of_left: Rectified, of_right: Rectified) -> list[Message]:
    """Return warnings about the P of a pair."""
    doubts = Values(right.document)
    if of_right.offset[0] > 0:
        baseline = f"P[0,3] = {of_right.projection[0, 3]:+.6g}"
        text = f"{baseline}: left and right file may be swapped"
        doubts.warn("swapped_cameras", "projection_matrix", text)
    if not np.allclose(of_left.projection[:, :3], of_right.projection[:, :3], rtol=1e-6, atol=1e-3):
        text = "differs from that of the left file in more than the baseline: check that both are of one pair"
        doubts.warn("inconsistent_projections", "projection_matrix", text)
    return doubts.warnings


def outputs(path: Path, file: CameraFile) -> tuple[Path, ...]:
    """Return the files that are written: the path itself, or in a folder one for each camera."""
    return (path,) if path.suffix or files.is_stream(path) else tuple(path / f"{name}.yaml" for name in file.cameras)


def write(path: Path, file: CameraFile) -> None:
    """Write one camera to a file, or a pair into a folder; see `of_pair`.

    Raises InvalidInput for a pair of which nothing says how it stands, or whose path is no folder; FileError.
    """
    names, entries = list(file.cameras), list(file.cameras.values())
    if len(entries) == 1:
        files.write_text(outputs(path, file)[0], _text(file, names[0], kept(entries[0]) or of_one(entries[0].camera)))
        return
    if path.suffix or path.is_file() or files.is_stream(path):
        raise InvalidInput(
            f"a pair is two files for ROS ({names[0]}.yaml, {names[1]}.yaml): give a folder", where=str(path)
        )
    pose = pose_between(file, names[1], names[0])
    if pose is None:
        raise InvalidInput(
            f"no transform joins {names[0]} and {names[1]}; write them one by one, FILE#NAME", where=str(path)
        )
    left, right = entries[0].camera, entries[1].camera
    both = _kept_pair(entries, pose) or of_pair(left, right, pose)
    for target, name, rectified in zip(outputs(path, file), names, both, strict=True):
        files.write_text(target, _text(file, name, rectified))


def text_of(message: Any, name: str) -> str:
    """Return the text of the file of a sensor_msgs/CameraInfo, of ROS 1 (D, K, R, P) or ROS 2 (d, k, r, p)."""
    D, K, R, P = (np.asarray(vars(message).get(each, vars(message).get(each.lower()))) for each in "DKRP")
    rectified = Rectified(R.reshape(3, 3), P.reshape(3, 4))
    data = _block((message.width, message.height), name, K.reshape(3, 3), (message.distortion_model, D), rectified)
    return emit.document(data, number=emit.exact_text)


def kept(entry: CameraEntry) -> Rectified | None:
    """Return the R and P that the camera's file had, None if there are none."""
    block: Any = entry.extra.get(VENDOR_KEY)
    try:
        rotation, projection = (np.array(block[key], dtype=float) for key in ("rectification", "projection"))
        return Rectified(rotation.reshape(3, 3), projection.reshape(3, 4))
    except (KeyError, TypeError, ValueError):
        return None


def _kept_pair(entries: Sequence[CameraEntry], right_T_left: Pose) -> tuple[Rectified, Rectified] | None:
    """Return the R and P that the files of a pair had, if they still say where the right camera stands."""
    left, right = map(kept, entries)
    if left is None or right is None:
        return None
    pose = right.placed_from(left)
    same = np.allclose(pose.matrix(), right_T_left.matrix(), rtol=0, atol=_SAME)
    return (left, right) if same else None


def _text(file: CameraFile, name: str, rectified: Rectified) -> str:
    camera = file.cameras[name].camera
    distortion = MODELS[camera.model.name], camera.parameters[4:]
    data = _block(camera.image_size, name, camera.K, distortion, rectified)
    return emit.document(data, f"OpenCV: {opencv_usage(file)}", number=emit.exact_text)


def _block(
    size: tuple[int, int], name: str, K: Array, distortion: tuple[str, Array], rectified: Rectified
) -> dict[str, Any]:
    """Return the keys of a camera; distortion: its model and the coefficients (N,)."""
    return {
        "image_width": size[0],
        "image_height": size[1],
        "camera_name": name,
        "camera_matrix": _matrix(K),
        "distortion_model": distortion[0],
        "distortion_coefficients": _matrix(distortion[1][None]),
        "rectification_matrix": _matrix(rectified.rotation),
        "projection_matrix": _matrix(rectified.projection),
    }


def _matrix(matrix: Array) -> Mapping[str, Any]:
    """Return a matrix as ROS reads it, with the dt that OpenCV asks for."""
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "dt": "d", "data": matrix.ravel().tolist()}


def of_one(camera: Camera) -> Rectified:
    """Return R = 1 and P = [K | 0]; of a fisheye P is that of a pinhole view, as wide as one can be without black."""
    view = camera
    if camera.model.name == "kannala_brandt4":
        from camcal.images.options import ViewOptions
        from camcal.images.views import make_view

        try:
            view = make_view(camera, ViewOptions())
        except InvalidInput:  # more than a pinhole holds
            view = camera
    return of_matrix(view)


def of_matrix(camera: Camera) -> Rectified:
    """Return R = 1 and P = [K | 0]."""
    return Rectified(np.eye(3), np.column_stack([camera.K, np.zeros(3)]))


def of_pair(left: Camera, right: Camera, right_T_left: Pose) -> tuple[Rectified, Rectified]:
    """Return R and P of both cameras: each turned by half of what lies between them, then along the baseline.

    The focal length is the smallest there is, the principal point is the same in both and centres what they see.
    """
    half = so3.exp(right_T_left.vector() / 2)
    middle_R_right = half.T
    baseline = middle_R_right @ right_T_left.translation
    align = _along_rows(baseline)
    rotations = align @ half, align @ middle_R_right
    focal = min(camera.value(name) for camera in (left, right) for name in ("fx", "fy"))
    width, height = left.image_size
    seen = np.mean([_centre(camera, turn) for camera, turn in zip((left, right), rotations, strict=True)], axis=0)
    cx, cy = (width - 1) / 2 - focal * seen[0], (height - 1) / 2 - focal * seen[1]
    matrix = np.array([(focal, 0, cx), (0, focal, cy), (0, 0, 1)])
    length = np.linalg.norm(baseline)
    offsets = np.zeros(3), length * np.round(align @ baseline / length)  # along one axis, without rounding errors
    first, second = (
        Rectified(turn, np.column_stack([matrix, matrix @ offset]))
        for turn, offset in zip(rotations, offsets, strict=True)
    )
    return first, second


def _along_rows(baseline: Array) -> Array:
    """Return the rotation (3, 3) to axes of which x, or y where the cameras stand above each other, is the baseline."""
    length = np.linalg.norm(baseline)
    if np.hypot(baseline[0], baseline[1]) <= _BESIDE * length:
        raise InvalidInput("the two cameras are at one place or behind each other: not a rectifiable pair")
    if abs(baseline[0]) >= abs(baseline[1]):
        x = baseline / length * np.copysign(1, baseline[0])
        y = np.cross(_Z, x)
        y /= np.linalg.norm(y)
    else:
        y = baseline / length * np.copysign(1, baseline[1])
        x = np.cross(y, _Z)
        x /= np.linalg.norm(x)
    return np.array([x, y, np.cross(x, y)])


def _centre(camera: Camera, rectified_R_camera: Array) -> Array:
    """Return the mean x / z, y / z (2,) of what a camera sees, in rectified axes."""
    width, height = camera.image_size
    grid = np.meshgrid(np.linspace(0, width - 1, _SAMPLES), np.linspace(0, height - 1, _SAMPLES))
    rays = camera.unproject(np.column_stack([axis.ravel() for axis in grid]))
    turned = rays.directions[rays.valid] @ rectified_R_camera.T
    near = turned[turned[:, 2] * _WIDEST > np.hypot(turned[:, 0], turned[:, 1])]
    return np.asarray((near[:, :2] / near[:, 2:]).mean(axis=0)) if len(near) else np.zeros(2)


ROS = CameraFormat(
    name="ros",
    title="ROS camera_info",
    suffixes=(".yaml", ".yml"),
    models=tuple(MODELS),
    read=read,
    write=write,
    outputs=outputs,
    most_cameras=2,
    files=2,
    in_folder=True,
)
