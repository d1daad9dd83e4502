"""What programs call where the shell has commands: images as files or as arrays, results in memory.

Nothing is written unless the options name a file. Arrays of images are files of a temporary folder while a task works
on them, so that an array and a file with the same pixels give the same numbers.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from camcal.arrays import Array, FloatArray, PixelArray, require_shape
from camcal.calibrate.rigs.record import Captures
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.formats import cameras, native
from camcal.formats.boards import load_board
from camcal.formats.camera_file import CameraEntry, CameraFile, ValidRegion
from camcal.images.files import gray_8bit, load
from camcal.images.options import ViewOptions
from camcal.images.remap import build_maps
from camcal.images.views import make_view
from camcal.progress import SILENT, Progress
from camcal.records import Brief
from camcal.stereo.cloud import CloudMaker
from camcal.stereo.depth import COLOUR, POSITION, StereoImage
from camcal.stereo.disparity import Confidence, Disparity, StereoGeometry
from camcal.stereo.options import RectifiedViewOptions
from camcal.stereo.rectify.plan import PairMaps, build_pair_maps, plan_rectification
from camcal.stereo.rectify.record import Rectification
from camcal.targets.board import Board
from camcal.targets.corner_measurement import measure
from camcal.targets.detect import locate
from camcal.targets.detection import BoardDetection, Detections, MaskedImage
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.calibrate import calibrated, seen_of
from camcal.tasks.calibration.camera_result import CalibrateReport
from camcal.tasks.calibration.detect import detect_images
from camcal.tasks.calibration.options import CalibrateOptions, DetectOptions
from camcal.tasks.rigs.calibrate_rig import calibrated as calibrated_rig
from camcal.tasks.rigs.matching import Matched
from camcal.tasks.rigs.options import RigSettings
from camcal.tasks.rigs.rig_result import RigReport
from camcal.tasks.rigs.rig_views import RigViews, captured_table, rig_views
from camcal.tasks.stereo.rig_pair import read_rig

File = str | Path
Images = File | Array | Sequence[File] | Sequence[Array]

_CALIBRATE, _DETECT, _VIEW, _RIG = CalibrateOptions(), DetectOptions(), ViewOptions(), RigSettings()
_RECTIFIED = RectifiedViewOptions()


def detect_board(
    images: Images, board: Board | File, options: DetectOptions = _DETECT, progress: Progress = SILENT
) -> Detections:
    """Return the points of a board in images and videos, an entry for each image.

    images: files, folders and patterns, or arrays (H, W) gray or (H, W, 3) BGR, uint8 or uint16; arrays are named
    images[0], images[1] and so on. board: a board, its file or its short form. options: without inputs and board.
    Raises FileError if nothing can be read, InsufficientData if the board is in no image.
    """
    with _inputs(images) as inputs:
        report = detect_images(replace(options, inputs=inputs.paths, board=_board(board)), progress)
        return replace(report.detections, views=inputs.renamed(report.detections.views))


def locate_board(image: File | Array, board: Board | File) -> BoardDetection:
    """Return where a board is in one image, in a fraction of the time of `detect_board`: for live views and trials.

    image: a file, or pixels (H, W) gray or (H, W, 3) BGR, uint8 or uint16. board: a board, its file or its short form.
    The corners of a checkerboard are good to a tenth of a pixel or two and have no covariance until `measure_corners`
    has measured them; tags and circles are measured as they are. Raises InvalidInput or FileError.
    """
    return locate(_gray(image), _board(board))


def measure_corners(image: File | Array, board: Board | File, located: BoardDetection) -> BoardDetection:
    """Return corners of a board of crossing edges measured in an image, with covariance (N, 2, 2) px².

    image, board: as for `locate_board`. located: what that returned, or corners of another program, good to half a
    pixel. Those that the image does not bear out are left out. Raises InvalidInput for a board of circles, and for ids
    that the board does not have.
    """
    gray, known = _gray(image), _board(board)
    if located.found and not 0 <= located.ids.min() <= located.ids.max() < known.count:
        raise InvalidInput(
            f"ids {located.ids.min()} to {located.ids.max()}: a {known.words} has 0 to {known.count - 1}"
        )
    return replace(measure(MaskedImage(gray), known, located), size=gray.shape[::-1])


def _gray(image: File | Array) -> Array:
    return gray_8bit(image if isinstance(image, np.ndarray) else load(Path(image)).pixels)


def calibrate_camera(
    images: Images | Detections | Sequence[BoardDetection],
    board: Board | File | None = None,
    options: CalibrateOptions = _CALIBRATE,
    progress: Progress = SILENT,
) -> CalibrateReport:
    """Return the calibration of one camera from images of a board, or from what was detected in them.

    images: as for `detect_board`, or a detections file. board: a board, its file or its short form; None where the
    detections name it. options: without inputs and board; nothing is written unless they name an output.
    Raises InvalidInput, FileError, InsufficientData or NotConverged. A calibration that is not trustworthy is no
    error: `trustworthy` says so.
    """
    known = None if board is None else _board(board)
    options = replace(options, inputs=(), board=None)
    if isinstance(images, Detections):
        return calibrated(lambda: _views(images, known), options, progress)
    if isinstance(images, Sequence) and all(isinstance(image, BoardDetection) for image in images):
        detections = Detections(None, tuple(image for image in images if isinstance(image, BoardDetection)))
        return calibrated(lambda: _views(detections, known), options, progress)
    with _inputs(images) as inputs:

        def look() -> BoardViews:
            seen = seen_of(replace(options, inputs=inputs.paths), known, progress)
            views = inputs.renamed(seen.detections.views)
            return replace(seen, detections=replace(seen.detections, views=views), files=inputs.files)

        return calibrated(look, options, progress)


def calibrate_rig(
    images: Mapping[str, Images] | Detections | Captures,
    board: Board | File | None = None,
    options: RigSettings = _RIG,
    progress: Progress = SILENT,
) -> RigReport:
    """Return the calibration of several cameras and where they stand.

    images: of every camera by its name, as for `detect_board`; or what was detected, with the cameras' names; or
    captures, which need no matching. board: a board, its file or its short form; None where the detections name it.
    options: without board; nothing is written unless they name an output. Raises InvalidInput, FileError,
    InsufficientData or NotConverged. A calibration that is not trustworthy is no error: `trustworthy` says so.
    """
    known = None if board is None else _board(board)
    with ExitStack() as folders:
        if isinstance(images, Captures):
            if known is None:
                raise InvalidInput("captures name no board: give one, such as 'chessboard:9x6:25mm'")
            seen = RigViews(known, Matched(images, "given"), table=True)
        elif isinstance(images, Detections):
            table = _views(images, known)
            by_camera: dict[str, list[BoardDetection]] = {}
            for view in images.views:
                by_camera.setdefault(view.camera, []).append(view)
            seen = replace(
                captured_table(table.board, by_camera, options, progress), circles=images.circles, table=True
            )
        else:
            inputs = {name: folders.enter_context(_inputs(own, name)) for name, own in images.items()}
            texts = [f"{name}={path}" for name, own in inputs.items() for path in own.paths]
            seen = rig_views(texts, replace(options, board=known), progress)
            views = {name: own.renamed(seen.of(name)) for name, own in inputs.items() if name in seen.captures.cameras}
            files = {name: path for own in inputs.values() for name, path in own.files.items()}
            seen = replace(seen.with_views(views), files=files)
        return calibrated_rig(lambda: seen, options, ["rig"], progress)


def write_camera_file(path: File, camera: Camera | CameraFile, kind: str = cameras.OWN) -> None:
    """Write a camera, under the name `camera`, or all of a camera file, in camcal's format or another one.

    kind: camcal, opencv, ros or kalibr. Raises InvalidInput, saying what would be lost, for what that format cannot
    hold exactly, and for a suffix that it does not have; FileError if the file cannot be written.
    """
    if isinstance(camera, Camera):
        camera = CameraFile({"camera": CameraEntry(camera, valid=ValidRegion.of(camera))})
    own = cameras.FORMATS[cameras.OWN]
    if kind == own.name:
        native.write(Path(path), camera)
    else:
        cameras.write(Path(path), camera, cameras.format_for(Path(path), kind, own))


@dataclass(frozen=True, eq=False)
class Undistorted(Brief):
    """An undistorted image: pixels (H, W) or (H, W, 3), and the camera that would have taken it."""

    pixels: PixelArray
    camera: Camera


def undistort_image(
    image: File | Array, camera: Camera, options: ViewOptions = _VIEW, interpolation: str = "linear"
) -> Undistorted:
    """Return an image without the distortion of the camera's lens; where the camera saw nothing it is black.

    image: a file, or pixels (H, W) or (H, W, 3), uint8, uint16 or float32. For many images, `make_view` and
    `build_maps` once, and Maps.apply for each. Raises InvalidInput if the image has another size than the camera's.
    """
    pixels = image if isinstance(image, np.ndarray) else load(Path(image)).pixels
    if pixels.shape[1::-1] != camera.image_size:
        found, wanted = ("{}x{}".format(*size) for size in (pixels.shape[1::-1], camera.image_size))
        raise InvalidInput(
            f"the image is {found}, the camera {wanted}; camcal.resized makes a camera for resized images"
        )
    view = make_view(camera, options)
    return Undistorted(build_maps(camera, view, interpolation).apply(pixels), view)


@dataclass(frozen=True, eq=False)
class RectifiedImages(Brief):
    """A rectified pair: images of the left (or upper) and of the right camera, and how they were made.

    maps: for more images of the same two cameras, `maps.apply(left, right)`.
    """

    left: PixelArray
    right: PixelArray
    rectification: Rectification
    maps: PairMaps


def rectify_pair(
    left: File | Array,
    right: File | Array,
    rig: File,
    options: RectifiedViewOptions = _RECTIFIED,
    interpolation: str = "linear",
) -> RectifiedImages:
    """Return the rectified images of two cameras of a rig file, FILE or FILE#LEFT,RIGHT.

    left, right: files, or pixels (H, W) or (H, W, 3), of the two cameras in this order. If the first one stands on the
    right of the second, they exchange places in the result (`rectification.swapped`). For many pairs, `maps.apply` of
    the first result, in the order of the result.
    Raises InvalidInput for images of another size and cameras without a transform, InsufficientData for a pair that has
    no common field or looks along its baseline, FileError.
    """
    first, second = (image if isinstance(image, np.ndarray) else load(Path(image)).pixels for image in (left, right))
    size = first.shape[1], first.shape[0]
    pair = read_rig(str(rig), None, lambda: size)
    found = plan_rectification(pair.cameras, pair.second_T_first, options, pair.circles)
    maps = build_pair_maps(pair.cameras, found, interpolation, pair.circles)
    images = maps.apply(second, first) if found.swapped else maps.apply(first, second)
    return RectifiedImages(images.left, images.right, found, maps)


@dataclass(frozen=True, eq=False)
class PointCloud(Brief):
    """Points (N, 3) in the frame of the rectified left camera, metres, and their colours (N, 3) RGB uint8, if known."""

    points: FloatArray
    colours: PixelArray | None = None


def point_cloud(disparity: Disparity | Array, geometry: StereoGeometry, image: Array | None = None) -> PointCloud:
    """Return the points that a disparity map shows, row by row.

    disparity: what `match_pair` returns, without pixels that were filled in or matched from one side only where it says
    so; or (H, W) pixels, NaN where there is none. image: the left image (H, W) or (H, W, 3) BGR, for the colours.
    """
    if isinstance(disparity, Disparity):
        values, kept = disparity.values, disparity.confidence >= Confidence.SINGLE
    else:
        values = require_shape(disparity, (None, None), "disparity", np.float32)
        kept = np.ones(values.shape, np.bool_)
    stereo = StereoImage(values, geometry, pixels=image)
    kept = kept & stereo.matched(slice(0, len(values)))
    stream = CloudMaker(stereo, kept).stream()
    vertices = np.concatenate([np.empty(0, stream.type), *stream.blocks])
    points = np.column_stack([vertices[name] for name in POSITION]).astype(np.float64)
    return PointCloud(points, None if image is None else np.column_stack([vertices[name] for name in COLOUR]))


@dataclass(frozen=True)
class _Inputs:
    """Images as paths; files: where arrays are kept, by the names that they have in results."""

    paths: tuple[str, ...]
    files: Mapping[str, Path] = field(default_factory=dict)

    def renamed(self, views: Sequence[BoardDetection]) -> tuple[BoardDetection, ...]:
        """Return views with the names of arrays in the place of their files'."""
        names = {path.as_posix(): name for name, path in self.files.items()}
        return tuple(replace(view, image=names.get(view.image, view.image)) for view in views)


@contextmanager
def _inputs(images: Images | Sequence[BoardDetection], name: str = "images") -> Iterator[_Inputs]:
    """Yield images as paths; arrays are written into a folder that is there for the block, as name[0], name[1] …

    Raises InvalidInput if they are not all files or all arrays.
    """
    every = [images] if isinstance(images, (str, Path, np.ndarray)) else list(images)
    paths = [str(image) for image in every if isinstance(image, (str, Path))]
    arrays = [image for image in every if isinstance(image, np.ndarray)]
    if len(every) not in (len(paths), len(arrays)):
        raise InvalidInput("images are given as files or as arrays, all of one kind")
    if not arrays:
        yield _Inputs(tuple(paths))
    else:
        with TemporaryDirectory(prefix="camcal-") as folder:
            files = {f"{name}[{index}]": Path(folder) / f"{index}.npy" for index in range(len(arrays))}
            for (array, path), pixels in zip(files.items(), arrays, strict=True):
                if pixels.dtype not in (np.uint8, np.uint16):
                    raise InvalidInput(f"{array}: images are uint8 or uint16, found {pixels.dtype}")
                np.save(path, pixels)
            yield _Inputs(tuple(map(str, files.values())), files)


def _board(board: Board | File) -> Board:
    if isinstance(board, (str, Path)):
        return load_board(board)
    if not isinstance(board, Board):
        raise InvalidInput(f"{board!r} is not a board: give one, its file or text such as 'chessboard:9x6:25mm'")
    return board


def _views(detections: Detections, board: Board | None) -> BoardViews:
    """Return detections with their board; raises InvalidInput if none is known."""
    known = board or detections.board
    if known is None:
        raise InvalidInput("the detections name no board: give one, such as 'chessboard:9x6:25mm'")
    return BoardViews(known, replace(detections, board=known), table=True)
