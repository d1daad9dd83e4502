"""Options of undistorted views, and limits of the image size.

Sizes are checked before memory is allocated for one that is stated in a header or asked for.
"""

import math
import os
from pathlib import Path
from typing import Annotated, NoReturn

from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.options import SIZE, Option, OptionsRecord

PINHOLE = "pinhole"
JPEG_QUALITY = 95  # what OpenCV writes when nothing is said
MAP_SUFFIXES = (".npz", ".exr", ".png", ".txt")  # of files that say where the pixels of a view come from
MESH_STEP = 16  # pixels between the nodes of a mesh, as is usual
VIEW = "View"  # title of these options
WIDEST_PINHOLE_DEG = 179.0


@dataclass(frozen=True)
class ViewOptions(OptionsRecord):
    """What a view shows.

    alpha: a pinhole from 0, the largest crop without an empty pixel, to 1, every pixel of the source; None is 0.
    keep_k: the source's own focal lengths and principal point. size: width and height, None the source's.
    projection: pinhole, cylinder, equirectangular or stereographic. fov_deg: field of view across the width.
    stretch: the crop may have another shape than the view; its pixels are then not square.
    """

    alpha: Annotated[
        float | None,
        Option(
            "0 (default): crop to valid pixels only; 1: keep all pixels of the image; or between.",
            metavar="0…1",
            group=VIEW,
            least=0,
            most=1,
        ),
    ] = None
    keep_k: Annotated[bool, Option("Keep the focal lengths and the principal point of the camera.", group=VIEW)] = False
    size: Annotated[
        tuple[int, int] | None,
        Option("Size of the output images; by default that of the camera.", metavar="WxH", group=VIEW, type=SIZE),
    ] = None
    projection: Annotated[
        str,
        Option(
            "Output projection: pinhole; for 180° and more cylinder, equirectangular or stereographic.",
            metavar="NAME",
            group=VIEW,
        ),
    ] = PINHOLE
    fov_deg: Annotated[
        float | None,
        Option(
            "Horizontal field of view; by default that of the lens.",
            metavar="DEGREES",
            group=VIEW,
            names="--fov",
        ),
    ] = None
    stretch: Annotated[
        bool, Option("Allow fx and fy to differ where that shows more of the image, as OpenCV does.", group=VIEW)
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        given = {"--alpha": self.alpha is not None, "--keep-k": self.keep_k, "--fov": self.fov_deg is not None}
        chosen = [name for name, wanted in given.items() if wanted]
        if len(chosen) > 1:
            raise InvalidInput(f"{' and '.join(chosen)} exclude each other")
        if self.projection != PINHOLE and (self.alpha is not None or self.keep_k or self.stretch):
            raise InvalidInput(f"--alpha, --keep-k and --stretch are for a pinhole; a {self.projection} takes --fov")
        widest = widest_deg(self.projection)
        if self.size is not None:
            if min(self.size) < 2:
                raise InvalidInput("a view has at least 2 pixels a side, asked for {}x{}".format(*self.size))
            require_view(self.size)
        if self.fov_deg is not None:
            self._require_holds(self.fov_deg, widest)

    def _require_holds(self, fov_deg: float, widest: float) -> None:
        """Raise InvalidInput unless a view, whose projection holds up to `widest` degrees, can span so many."""
        if not math.isfinite(fov_deg) or fov_deg <= 0:
            raise InvalidInput(f"a field of view is positive, found {fov_deg:g}°")
        if fov_deg <= widest:
            return
        if self.projection == PINHOLE:
            refuse_pinhole(math.radians(fov_deg))
        raise InvalidInput(f"a {self.projection} view holds up to {widest:g}°, asked for {fov_deg:g}°")


def widest_deg(projection: str) -> float:
    """Return the largest field of view across; raises InvalidInput for a projection that does not exist."""
    from camcal.cameras.panoramic import MODELS

    widest = {PINHOLE: WIDEST_PINHOLE_DEG, **{model.name: model.widest_deg for model in MODELS}}
    if projection not in widest:
        raise InvalidInput(f"projection {projection!r} is unknown; use one of {', '.join(widest)}")
    return widest[projection]


def refuse_pinhole(widest: float) -> NoReturn:
    """Raise InvalidInput: no pinhole holds a field of view of `widest` (rad)."""
    raise InvalidInput(
        f"{math.degrees(widest):.0f}° exceeds the field of view of a pinhole (less than 180°): use --projection "
        "cylinder, equirectangular or stereographic, or --fov for a part of it"
    )


LONGEST_SIDE = 1 << 20  # pixels, of images that OpenCV reads
DEFAULT_MAX_PIXELS = 300_000_000
VARIABLE = "OPENCV_IO_MAX_IMAGE_PIXELS"  # OpenCV's own; worker processes inherit it


def set_default_max_pixels() -> None:
    """Let the limit hold for OpenCV too, which reads it when it is imported; one in the environment stays."""
    os.environ.setdefault(VARIABLE, str(DEFAULT_MAX_PIXELS))


def set_max_pixels(count: int) -> None:
    """Set the limit for this process and those it starts."""
    os.environ[VARIABLE] = str(count)


def max_pixels() -> int:
    """Return how many pixels an image may have."""
    said = os.environ.get(VARIABLE, "")
    return int(said) if said.isascii() and said.isdigit() else DEFAULT_MAX_PIXELS


def require_view(size: tuple[int, int]) -> None:
    """Raise InvalidInput if a view of `size` (width, height) has more pixels than are allowed, or too long a side."""
    width, height = size
    if max(size) > LONGEST_SIDE:
        raise InvalidInput(f"{width}x{height} has a side of more than {LONGEST_SIDE} pixels, which is the limit")
    if width * height > max_pixels():
        megapixels, allowed = width * height / 1e6, max_pixels() / 1e6
        message = f"a view of {width}x{height} has {megapixels:.0f} million pixels, more than --max-pixels {allowed:g}"
        raise InvalidInput(f"{message}; increase it if that is wanted")


def require_pixels(size: tuple[int, int], path: Path) -> None:
    """Raise FileError if an image of `size` (width, height) has more pixels than are allowed, or none."""
    width, height = size
    if width < 1 or height < 1:
        raise FileError(f"invalid image size {width} x {height}: damaged header", where=str(path))
    if width * height > max_pixels():
        megapixels, allowed = width * height / 1e6, max_pixels() / 1e6
        message = f"{width} x {height} are {megapixels:.0f} million pixels, more than --max-pixels {allowed:g}"
        raise FileError(f"{message}; increase it if the header is right", where=str(path))
