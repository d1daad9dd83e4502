"""What a camera format is: what it can hold, how its files are told from others, read and written.

Files are told from each other by patterns in their text, never by their name. A row is a family: `name` is that of
the format; families that are not read have a title and what to do instead. What is told by less comes last.
"""

import re
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from functools import cache
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
from camcal.formats.cameras.values import Lenses
from camcal.formats.native import NAME
from camcal.geometry.pose import JOINT

CAMERA, LEFT, RIGHT = "camera", "left", "right"  # names of cameras whose file gives none
EVERY_LENS = tuple(MODELS)  # of a format that has any lens, or none
ANY_FRAME = frozenset({"*"})

_CAMCHAIN = (r"^cam\d+[ \t]*:", r"^[ \t]+(?:camera_model|intrinsics)[ \t]*:")
_COLMAP_MODELS = "(?:SIMPLE_|FULL_|RAD_TAN_)?(?:PINHOLE|RADIAL|OPENCV|FOV|THIN_|DIVISION|FISHEYE|EUCM|EQUIRECT)"
# a count of 64 bits, then id, model, width and height of the first camera, little endian, none of them 0 but the id
_COLMAP_BINARY = r"\A(?!\0\0)[\s\S]{2}\0{6}[\s\S]{3}\0[\0-\x14]\0{3}(?:(?!\0{3})[\s\S]{3}\0{5}){2}"
# a count, then number and sensors of the first rig, type (camera) and number of its first sensor
_COLMAP_RIGS = (
    r"\A(?!\0\0)[\s\S]{2}\0{6}[\s\S]{2}\0{2}[\1-\xff]\0{7}[\s\S]{2}\0{2}(?:\Z|[\0\1]\0{3}[\s\S]{2}\0{2}[\0\1])"
)
_OPENCV = (
    "camera_matrix|Camera_Matrix|cameraMatrix|CameraMatrix|camera_Matrix|intrinsic_matrix|K|mtx|M1|K1|cameraMatrix1"
)
_HEAD = 1 << 20  # characters in which the signs are
_BY_NUMBERS = "give --camera-matrix FX,FY,CX,CY, --distortion and --size WxH"


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


class Row(NamedTuple):
    """A family of camera files.

    signs: patterns that all occur in its text; of a binary file in its bytes as Latin-1. names: of files that are
    written as this family without --to. title, instead: of a family that is not read, and the way out; with a name it
    is written all the same.
    """

    name: str
    signs: tuple[str, ...]
    names: tuple[str, ...] = ()
    title: str = ""
    instead: str = ""


def _key(name: str) -> str:
    """Return the pattern of a key of JSON."""
    return rf'"(?:{name})"\s*:'


ROWS = (
    Row("camcal", (r"^[\"']?format[\"']?[ \t]*:[ \t]*[\"']?camcal-calibration",)),
    Row("", (r"\A(?:\x93NUMPY|PK\x03\x04)",), (), "NumPy arrays", _BY_NUMBERS),
    Row("isaac", (r"\A#usda|\APXR-USDC",), ("*.usda",), "USD camera (Isaac, Omniverse, Blender)", _BY_NUMBERS),
    Row("", (r"\ABLENDER",), ("*.blend",), "Blender scene",
        "give --camera-matrix: fx is focal length / sensor width x image width"),
    Row("", (r"\APix4D camera calibration file",), ("*.cam",), "Pix4D calibrated internal parameters",
        "export OpenCV or Metashape XML"),
    Row("", (r"\A# Bundle file",), ("*.out",), "Bundler", "import it in COLMAP and give cameras.txt"),
    Row("", (r"\ANVM_V3",), ("*.nvm",), "VisualSFM", "import it in COLMAP and give cameras.txt"),
    Row("", (r"^#?[ \t]*(?:IMAGE_ID, QW|Image list with|3D point list)",),
        ("images.txt", "images.bin", "points3D.*", "frames.*"),
        "COLMAP images and points", "give cameras.txt of the same model"),
    Row("", (r"^(?:ParGroup: Cameras|#? *INTERNAL CAMERA PARAMETERS)",), ("*.cal",), "HALCON camera parameters",
        _BY_NUMBERS),
    Row("", (r"^\[(?:LEFT|RIGHT)_CAM_\w+\]",), ("*.conf",), "ZED calibration",
        "give fx, fy, cx, cy of one section as --camera-matrix, k1, k2, p1, p2, k3 as --distortion, and --size WxH"),
    Row("", (r"^[ \t]*Model *= *CAHV",), ("*.cahv", "*.cahvor", "*.cahvore"), "CAHVOR camera model",
        "give the .cameramodel that mrcal-from-cahvor makes of it"),
    Row("ocamcalib", ("polynomial coefficients for the DIRECT mapping",), ("calib_results.txt",)),
    Row("", (r"^ocam_model",), (), "OCamCalib", "export it there as calib_results.txt"),
    Row("", (r"^(?:Pinhole|RadTan|EquiDistant|KannalaBrandt|FOV)\s+[-\d.]+\s",), (), "DSO camera.txt", _BY_NUMBERS),
    Row("", (r"^PhotoModeler",), (), "PhotoModeler camera", _BY_NUMBERS),
    # XML
    Row("", (r"xcr:(?:Version|FocalLength35mm|Rotation)",), ("*.xmp",), "RealityCapture XMP",
        "export the scene to COLMAP and give cameras.txt"),
    Row("", (r"stCamera:|photoshop/1.0/camera-profile",), ("*.lcp",), "Adobe lens profile",
        "it has no pixels: calibrate with images of a board"),
    Row("urdf", (r"<robot[\s>]",), ("*.urdf", "*.xacro"), "URDF robot", "give the camera_info of its camera"),
    Row("ros_tf", (r"<launch[\s>]",), ("*.launch", "*.launch.xml"), "ROS launch file",
        "give the camera_info of its camera"),
    Row("lensfun", (r"<lensdatabase[\s>]",), ("*lensfun*.xml",)),
    Row("metashape", (r"<(?:sensor|calibration)\s[^>]{0,200}?(?:type|class)=|<calibration>\s*<pro|<document version=",),
        ("*metashape*.xml", "*agisoft*.xml")),
    Row("visp", (r"<root>", r"<camera>", r"<model>"), ("*visp*.xml",)),
    # JSON
    Row("gyroflow", (_key("fisheye_params"),), ("*gyroflow*.json",)),
    Row("", (_key("polymorphic_name|sfm_data_version"),), ("sfm_data.json",), "OpenMVG scene",
        "export it with openMVG_main_openMVG2Colmap and give cameras.txt"),
    Row("", (_key("intrinsicId"),), ("*.sfm",), "AliceVision (Meshroom) scene",
        "export it to COLMAP and give cameras.txt"),
    Row("", (_key("CalibrationInformation"),), (), "Azure Kinect calibration", _BY_NUMBERS),
    Row("", (_key("CameraCalibrations"),), (), "Project Aria calibration",
        "write its fisheye624 as COLMAP's RAD_TAN_THIN_PRISM_FISHEYE, or undistort the images with projectaria_tools"),
    Row("", (_key(r"intrinsic_left\.x\.x"),), (), "RealSense advanced-mode table",
        "give the intrinsics that rs-enumerate-devices -c prints, as --camera-matrix and --distortion"),
    Row("", (_key("cam_K"),), ("scene_camera.json",), "BOP scene cameras", _BY_NUMBERS),
    Row("", (_key("depth_scale"), _key("fx")), (), "BOP camera", _BY_NUMBERS),
    Row("nerfstudio", (_key("fl_x|camera_angle_x|transform_matrix"),), ("transforms*.json", "*nerfstudio*.json")),
    Row("basalt", (_key("camera_type"), _key("value0")), ("*basalt*.json",)),
    Row("opensfm", (_key("projection_type"),),
        ("cameras.json", "camera_models.json", "reconstruction.json", "*opensfm*.json")),
    Row("depthai", (_key("cameraData"),), ("*depthai*.json",)),
    Row("photonvision", (_key("cameraIntrinsics"),), ("*photonvision*.json",)),
    Row("realsense", (_key("ppx"), _key("ppy")), ("*realsense*.json",)),
    Row("matlab", (rf"\AMATLAB [57]\.\d|{_key('RadialDistortion|MappingCoefficients|DistortionCoefficients')}",),
        ("*.mat", "*matlab*.json")),
    Row("open3d", (_key("intrinsic_matrix"), _key("width")), ("*open3d*.json",)),
    # what is told by a few keys or words of its own
    Row("colmap", (_COLMAP_BINARY,), ("cameras.bin",)),
    Row("colmap", (_COLMAP_RIGS,), ("rigs.bin",)),
    Row("colmap", (rf"^\d+ {_COLMAP_MODELS}\w* \d+ \d+ |^# (?:Camera list with one|Rig calib list)",),
        ("cameras.txt", "rigs.txt")),
    Row("mrcal", (r"['\"]lensmodel['\"]\s*:",), ("*.cameramodel",)),
    Row("bouguet", (r"^[ \t]*fc(?:_left)?[ \t]*=[ \t]*\[", r"^[ \t]*cc(?:_left)?[ \t]*=[ \t]*\["), ("*.m",)),
    Row("ros_ini", (r"^\[image\]", r"^camera matrix"), ("*.ini",)),
    Row("caliscope", (r"^\[(?:cameras\.)?\"?\d+\"?\]|^\[cameras\.", r"^(?:matrix|distortions|cam_id|port) *="),
        ("camera_array.toml", "*caliscope*.toml")),
    Row("anipose", (r"^\[[\w.\"' -]+\]", r"^(?:matrix|distortions)\s*="), ("*.toml",)),
    Row("middlebury", (r"^cam0\s*=\s*\[",), ("calib.txt",)),
    Row("kitti", (r"^(?:P0|P2|P_rect_0\d|K_0\d):",), ()),
    # YAML
    Row("", (r"^cam0_calib[ \t]*:",), (), "VINS-Fusion configuration",
        "give the files that it names under cam0_calib and cam1_calib"),
    Row("vins", (r"^model_type[ \t]*:", r"^(?:projection|mirror|distortion)_parameters|^(?:poly|inv_poly)_parameters"),
        ("*vins*.yaml", "*vins*.yml")),
    Row("orbslam3", (r"^Camera\d?\.(?:type|fx)[ \t]*:",), ("*orb*slam*.yaml", "*orb*slam*.yml")),
    Row("euroc", (r"^T_BS[ \t]*:",), ("sensor.yaml",)),
    Row("boofcv", (r"^[ \t]*pinhole[ \t]*:\s*(?:$|\{)", r"^model[ \t]*:"), ("*boofcv*.y*ml",)),
    Row("openvins", (r"\A%YAML:", *_CAMCHAIN), ("*imucam_chain*.y*ml", "*openvins*.y*ml")),
    Row("kalibr", _CAMCHAIN, ("*camchain*.y*ml",)),
    Row("ros", (r"^camera_matrix[ \t]*:", r"^(?:projection_matrix|rectification_matrix|distortion_model)[ \t]*:")),
    Row("opencv", (rf"<opencv_storage|opencv-matrix|^[ \t]*[\"']?(?:{_OPENCV})[\"']?[ \t]*:",)),
)  # fmt: skip


@cache
def _patterns(signs: tuple[str, ...]) -> tuple[re.Pattern[str], ...]:
    return tuple(re.compile(sign, re.MULTILINE) for sign in signs)


def recognise(text: str) -> Row | None:
    """Return the family of a text, None if it is of none."""
    text = text[:_HEAD]
    return next((row for row in ROWS if all(each.search(text) for each in _patterns(row.signs))), None)


def named(name: str) -> Row | None:
    """Return the family that files of this name belong to; None for a name that any program may give."""
    lower = name.lower()
    return next((row for row in ROWS if any(fnmatchcase(lower, pattern.lower()) for pattern in row.names)), None)
