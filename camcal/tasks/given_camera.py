"""The camera of a command: one of a camera file of any format, or one whose numbers the command line gives."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.cameras.catalogue import model_named
from camcal.cameras.directions import GRID, grid_pixels
from camcal.cameras.lens import FISHEYE
from camcal.cameras.model import Camera, require_central
from camcal.errors import InvalidInput
from camcal.formats import cameras, split_address
from camcal.formats.camera_file import CalibrationVerdict, CameraEntry, CameraFile, Framing, framed
from camcal.formats.cameras.record import CAMERA, Given, MissingSize
from camcal.images.videos import address_of, is_video
from camcal.messages import Message
from camcal.progress import SILENT, Progress
from camcal.quality.projection_uncertainty import in_polygon
from camcal.run.paths import IMAGE_SUFFIXES, require_there
from camcal.tasks.options import WHOLE, GivenCamera, ImagePart

Size = tuple[int, int]
_OUTSIDE = 0.02  # of a view or of points: more beyond the region of the verdict is worth a warning


def _unknown() -> None:
    return None


def read_camera_file(
    address: str | None,
    given: GivenCamera,
    progress: Progress = SILENT,
    size_of_images: Callable[[], Size | None] = _unknown,
    second: Path | None = None,
    *,
    central: bool = True,
) -> CameraFile:
    """Return the content of the camera file FILE or FILE#NAME, or one with the camera that is given in its place.

    size_of_images: asked where neither the options nor the file say for which size of images the camera is. second: the
    other file of a rig that is written as two. central: whether lenses must be central.
    Raises InvalidInput for an image in place of the file, where the size remains unknown, for a lens that is not
    central, and as `cameras.read` and `framed` do.
    """
    file = framed(_read_camera_file(address, given, progress, size_of_images, second), framing_of(given.part))
    return central_file(file, address) if central else file


def central_file(file: CameraFile, where: str | Path | None) -> CameraFile:
    """Return a camera file from where it was read; raises InvalidInput for a lens that is not central."""
    for entry in file.cameras.values():
        require_central(entry.camera.model, None if where is None else str(where))
    return file


def framing_of(part: ImagePart) -> Framing:
    """Return which part of a camera's images the given ones are."""
    return Framing(part.crop, part.binning or 1, part.scale_to)


def require_whole(part: ImagePart, instead: str) -> None:
    """Raise InvalidInput for a part of the images of a camera that is in no file."""
    if part != WHOLE:
        raise InvalidInput(f"--crop, --binning and --scale-to go with {instead}")


def read_part(
    path: Path, part: ImagePart, progress: Progress = SILENT, size: Size | None = None, *, central: bool = True
) -> CameraFile:
    """Return the content of a camera file, its cameras those of a part of their images; size: where the file has none.
    central: as of `read_camera_file`.

    Raises InvalidInput and FileError as `cameras.read`, `framed` and `central_file` do.
    """
    file = framed(cameras.read(path, progress, Given(size)), framing_of(part))
    return central_file(file, path) if central else file


def _read_camera_file(
    address: str | None,
    given: GivenCamera,
    progress: Progress,
    size_of_images: Callable[[], Size | None],
    second: Path | None,
) -> CameraFile:
    if given.camera_matrix is not None:
        size = given.size or size_of_images()
        if size is None:
            raise InvalidInput("--camera-matrix: for which size of images? Give --size WxH")
        return CameraFile({CAMERA: CameraEntry(camera_of(given, size))})
    if address is None:
        raise InvalidInput("no camera: give a camera file, or --camera-matrix FX,FY,CX,CY")
    path = split_address(address)[0]
    require_no_image(path)
    require_there(path)
    try:
        return cameras.read(path, progress, Given(given.size, given.model), second)
    except MissingSize:
        if (size := size_of_images()) is None:
            raise
        return cameras.read(path, progress, Given(size, given.model), second)


def require_no_image(path: Path) -> None:
    """Raise InvalidInput if what stands for a camera file is an image, a video, a folder of them, or an array file."""
    if path.suffix.lower() == ".npz":
        raise InvalidInput("holds arrays, such as maps, where a camera file is needed", where=str(path))
    if address_of(path) is not None:
        return  # it may hold camera_info
    if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES or is_video(path):
        what = "a folder" if path.is_dir() else "an image or video"
        raise InvalidInput(
            f"is {what} where a camera file is needed: put CAMERA first, or give --camera-matrix FX,FY,CX,CY",
            where=str(path),
        )


def camera_of(given: GivenCamera, size: Size) -> Camera:
    """Return the camera of --camera-matrix and --distortion for images of (width, height).

    Raises InvalidInput if the coefficients are not as many as their lens model has.
    """
    fx, fy, cx, cy = given.camera_matrix or ()
    matrix = np.array([(fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)])
    distortion: Sequence[float] = given.distortion or ()
    model = None if given.model is None else model_named(given.model)
    if model is not None and len(distortion) != len(model.parameter_names) - 4:
        names = ",".join(model.parameter_names[4:])
        raise InvalidInput(
            f"--distortion: {model.name} has {names or 'no coefficients'}, found {len(distortion)} numbers"
        )
    if model is not None and not model.opencv:
        raise InvalidInput(f"--model {given.model}: OpenCV has no such lens; write a camera file")
    try:
        return Camera.from_opencv(matrix, distortion, size, fisheye=model is not None and model.opencv == FISHEYE)
    except InvalidInput as error:
        raise InvalidInput(f"--camera-matrix, --distortion: {error.message}") from error


def outside_region(
    verdict: CalibrationVerdict | None, pixels: Array, what: str, advice: str, where: str | None = None
) -> Iterator[Message]:
    """Yield a warning where pixels (N, 2) lie outside the part of the image that the verdict on the camera holds for.

    what: the pixels are of, such as a view. advice: what to do. where: the camera, if there are several.
    """
    region = verdict and verdict.region
    share = float(np.mean(~in_polygon(pixels, region.polygon))) if region and len(pixels) else 0.0
    if region and share > _OUTSIDE:
        text = (
            f"projection uncertainty above {region.limit_px:.2g} px in {100 * share:.0f} % of {what}, where the "
            f"verdict on the camera does not hold: {advice}"
        )
        yield Message("outside_region", text, {"share": share}, where)


def view_outside_region(
    verdict: CalibrationVerdict | None,
    camera: Camera,
    view: Camera,
    where: str | None = None,
    view_R_camera: Array | None = None,
) -> Iterator[Message]:
    """Yield a warning where a view shows more of the image of a camera than the verdict on it holds for."""
    if verdict is None or verdict.region is None:
        return
    width, height = view.image_size
    pixels = grid_pixels(np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1]))
    directions = view.unproject(pixels).at()
    shown = camera.project(directions if view_R_camera is None else directions @ view_R_camera).pixels
    shown = shown[((shown >= 0) & (shown <= np.array(camera.image_size) - 1)).all(axis=1)]
    advice = "use a smaller --fov, or calibrate with corners there"
    yield from outside_region(verdict, shown, "the view", advice, where)
