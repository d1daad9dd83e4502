"""The maps of a rectified pair: made once, for any number of pairs of images."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from camcal.arrays import Array, BoolArray, Float32Array, PixelArray
from camcal.brief import Brief
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.images.remap import Maps, build_maps
from camcal.stereo.rectify.record import Rectification


class ImagePair(NamedTuple):
    """Two images, the left (or upper) one first, in the type of their sources."""

    left: PixelArray
    right: PixelArray


@dataclass(frozen=True, eq=False)
class PairMaps(Brief):
    """Where every pixel of the rectified images of the left and of the right camera comes from."""

    left: Maps
    right: Maps

    def apply(self, left: Array, right: Array) -> ImagePair:
        """Return the rectified images of those of the left and of the right camera, black where they saw nothing.

        Raises InvalidInput for images of another size than the camera's.
        """
        return ImagePair(self.left.apply(left), self.right.apply(right))

    @property
    def valid(self) -> tuple[BoolArray, BoolArray]:
        """The masks (H, W) of the pixels that have a source."""
        return self.left.valid(), self.right.valid()

    def arrays(self, names: tuple[str, str] = ("left", "right")) -> dict[str, Float32Array]:
        """Return the maps (H, W) as cv2.remap takes them: NAME_map1 with columns, NAME_map2 with rows of the source."""
        return {
            f"{name}_map{number}": values
            for name, maps in zip(names, (self.left, self.right), strict=True)
            for number, values in ((1, maps.x), (2, maps.y))
        }


def build_pair_maps(
    cameras: Mapping[str, Camera],
    rectification: Rectification,
    interpolation: str = "linear",
    circles: Mapping[str, ImageCircle | None] | None = None,
) -> PairMaps:
    """Return the maps for a rectification of two cameras by their names; circles: as in `plan_rectification`.

    Raises InvalidInput for an unknown interpolation.
    """
    found = rectification
    known = circles or {}
    left, right = (
        build_maps(cameras[name], view, interpolation, turn.T, known.get(name))
        for name, view, turn in (
            (found.left, found.left_camera, found.rect_R_left),
            (found.right, found.right_camera, found.rect_R_right),
        )
    )
    return PairMaps(left, right)
