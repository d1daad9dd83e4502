"""Options of undistorted views."""

from dataclasses import dataclass
from typing import Annotated

from camcal.errors import InvalidInput
from camcal.options import SIZE, Option, OptionsRecord

PINHOLE = "pinhole"
JPEG_QUALITY = 95  # what OpenCV writes when nothing is said
VIEW = "View"  # title of these options


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
        from camcal.images.views import require_possible

        super().__post_init__()
        given = {"--alpha": self.alpha is not None, "--keep-k": self.keep_k, "--fov": self.fov_deg is not None}
        chosen = [name for name, wanted in given.items() if wanted]
        if len(chosen) > 1:
            raise InvalidInput(f"{' and '.join(chosen)} exclude each other")
        if self.projection != PINHOLE and (self.alpha is not None or self.keep_k or self.stretch):
            raise InvalidInput(f"--alpha, --keep-k and --stretch are for a pinhole; a {self.projection} takes --fov")
        require_possible(self.projection, self.size, self.fov_deg)
