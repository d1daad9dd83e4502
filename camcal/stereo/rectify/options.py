"""What a rectified pair shows, as the user asks for it."""

from dataclasses import dataclass
from math import isfinite
from typing import Annotated

from camcal.errors import InvalidInput
from camcal.images.options import require_view
from camcal.options import SIZE, Option, OptionsRecord, separated

VIEW = "View"  # title of these options
AUTO = "auto"
CHOICES = (AUTO, "pinhole", "cylindrical", "latlon")
_FIELD = separated("HORIZONTALxVERTICAL in degrees, such as 90x60", "x", 2)


@dataclass(frozen=True)
class RectifiedViewOptions(OptionsRecord):
    """What the rectified images show; None is found from what both cameras see.

    projection: one of CHOICES. fov_deg: horizontal and vertical field of view of each image. size: width and height.
    scale: of the focal length. alpha: from 0, valid pixels only, to 1, the whole common field. zero_disparity: one
    centre for both images, so that what is infinitely far has no disparity.
    """

    projection: Annotated[
        str,
        Option(
            "Projection; auto chooses by field of view: pinhole up to about 100°, then cylindrical, then latlon "
            "(equirectangular if one camera is above the other).",
            metavar="NAME",
            group=VIEW,
            choices=CHOICES,
        ),
    ] = AUTO
    fov_deg: Annotated[
        tuple[float, ...] | None,
        Option(
            "Horizontal and vertical field of view; by default what both cameras see.",
            metavar="HxV",
            group=VIEW,
            names="--fov",
            type=_FIELD,
        ),
    ] = None
    size: Annotated[
        tuple[int, int] | None,
        Option(
            "Size of the rectified images; by default by the resolution of the cameras.",
            metavar="WxH",
            group=VIEW,
            type=SIZE,
        ),
    ] = None
    scale: Annotated[
        float | None,
        Option("Factor on the default focal length and size: 0.5 halves both.", metavar="FACTOR", group=VIEW),
    ] = None
    alpha: Annotated[
        float,
        Option(
            "1 (default): keep the common field; 0: crop to pixels that are valid in both images; or between.",
            metavar="0…1",
            group=VIEW,
            least=0,
            most=1,
        ),
    ] = 1.0
    zero_disparity: Annotated[
        bool,
        Option("Same principal point in both images (doffs 0); by default only where that costs little.", group=VIEW),
    ] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scale is not None and not (isfinite(self.scale) and self.scale > 0):
            raise InvalidInput(f"--scale must be positive, found {self.scale:g}")
        if self.scale is not None and self.size is not None:
            raise InvalidInput("--scale and --size exclude each other")
        if self.fov_deg is not None and not all(0 < angle < 360 for angle in self.fov_deg):
            raise InvalidInput("--fov: a field of view is between 0° and 360°")
        if self.size is not None:
            if min(self.size) < 2:
                raise InvalidInput("--size: at least 2x2 pixels")
            require_view(self.size)
