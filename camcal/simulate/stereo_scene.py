"""Pairs of photographs of a generated world, rectified, with the exact disparity of every pixel.

The left camera stands in the origin of the world, the right one `baseline` to its right; both see along z.
"""

from dataclasses import dataclass, fields

import numpy as np

from camcal.arrays import Array, readonly
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.simulate.stereo_eyes import Eye, disparity
from camcal.simulate.stereo_picture import SHARPEST, picture
from camcal.simulate.stereo_surfaces import Surface
from camcal.simulate.stereo_world import Sight, make_world

GRAY = np.array([0.114, 0.587, 0.299])  # of BGR, ITU-R BT.601


@dataclass(frozen=True)
class PairOptions:
    """Cameras, world, light and errors of a pair.

    size: (width, height). focal: pixels. baseline: metres. doffs: cx of the right camera less cx of the left, pixels.
    disparities: least and greatest that the left image may have, pixels. objects: how many stand in the world.
    blur: standard deviation of the Gaussian in the point spread, pixels. noise: its standard deviation in 1/255 of
    full scale. gain, offset (in 1/255 of full scale), gamma: of the right image, whose brightness b becomes
    gain · b^gamma + offset. row_shift: by how many pixels the right image lies too low; row_tilt: by how much more at
    its right border than at its left one. depth: 8 or 16 bits. colour: BGR, else gray.
    """

    size: tuple[int, int] = (640, 480)
    focal: float = 560.0
    baseline: float = 0.1
    doffs: float = 0.0
    disparities: tuple[float, float] = (6.0, 64.0)
    objects: int = 14
    blur: float = 0.4
    noise: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    gamma: float = 1.0
    row_shift: float = 0.0
    row_tilt: float = 0.0
    depth: int = 8
    colour: bool = True

    def __post_init__(self) -> None:
        if not all(np.isfinite(getattr(self, each.name)).all() for each in fields(self)):
            raise InvalidInput("the numbers of a pair must be finite")
        if min(self.size) < 16 or max(self.size) > 32000:
            raise InvalidInput(f"images of {self.size[0]} × {self.size[1]} are not simulated; use 16 to 32000 a side")
        if self.focal <= 0 or self.baseline <= 0 or self.gain <= 0 or self.gamma <= 0:
            raise InvalidInput("focal length, baseline, gain and gamma must be positive")
        if self.noise < 0 or self.objects < 0 or not SHARPEST <= self.blur <= 5:
            raise InvalidInput(f"noise and objects are 0 or more, blur is {SHARPEST} to 5 px")
        if self.depth not in (8, 16):
            raise InvalidInput(f"depth of {self.depth} bits: use 8 or 16")
        least, greatest = self.disparities
        if not 0 < least + self.doffs < greatest + self.doffs:
            raise InvalidInput(
                f"disparities of {least:g} to {greatest:g}: the least plus doffs must be above 0 and below the greatest"
            )
        if greatest - least >= self.size[0] or greatest + self.doffs >= 2 * self.focal:
            raise InvalidInput(f"disparities up to {greatest:g} px do not fit images {self.size[0]} px wide")

    @property
    def depths(self) -> tuple[float, float]:
        """The nearest and the farthest depth, metres."""
        least, greatest = self.disparities
        reach = self.focal * self.baseline
        return reach / (greatest + self.doffs), reach / (least + self.doffs)

    def cameras(self) -> tuple[Camera, Camera, Pose]:
        """Return the left camera, the right camera and right_T_left."""
        model = model_named("pinhole")
        middle = (np.array(self.size) - 1) / 2
        left, right = (
            Camera(model, self.size, np.array([self.focal, self.focal, middle[0] + shift, middle[1]]))
            for shift in (0.0, self.doffs)
        )
        return left, right, Pose(np.eye(3), np.array([-self.baseline, 0.0, 0.0]))


@dataclass(frozen=True, eq=False)
class Scene:
    """A world and how it is photographed."""

    surfaces: tuple[Surface, ...]
    options: PairOptions


@dataclass(frozen=True, eq=False)
class StereoTruth:
    """A pair of images and what is true of it.

    left, right: (H, W) or (H, W, 3) BGR, uint8 or uint16. disparity_left, disparity_right: (H, W) float32 pixels at
    the middle of every pixel, column in the left less column in the right image, NaN where nothing is seen.
    visible: (H, W) bool, whether the point that a left pixel shows is in the right image and nothing hides it there.
    left_camera, right_camera: the pinholes that took them, had the right image no vertical error.
    """

    left: Array
    right: Array
    disparity_left: Array
    disparity_right: Array
    visible: Array
    left_camera: Camera
    right_camera: Camera
    right_T_left: Pose

    def __post_init__(self) -> None:
        height, width = self.left.shape[:2]
        for name, dtype in (("disparity_left", np.float32), ("disparity_right", np.float32), ("visible", np.bool_)):
            object.__setattr__(self, name, readonly(getattr(self, name), (height, width), name, dtype))
        for name in ("left", "right"):
            image = getattr(self, name)
            object.__setattr__(self, name, readonly(image, (height, width, *image.shape[2:]), name, image.dtype))


def make_scene(options: PairOptions, rng: np.random.Generator) -> Scene:
    """Return a scene drawn for these cameras and disparities."""
    near, far = options.depths
    middle = (options.size[0] - 1) / 2, (options.size[1] - 1) / 2
    sight = Sight(options.size, options.focal, middle, near, far, max(options.disparities[1], 0.0))
    return Scene(make_world(sight, options.objects, rng), options)


def render_pair(scene: Scene | PairOptions, rng: np.random.Generator) -> StereoTruth:
    """Return the photographs of a scene, or of one that is drawn first, and their truth; rng also draws the noise."""
    if isinstance(scene, PairOptions):
        scene = make_scene(scene, rng)
    options = scene.options
    left_eye, right_eye = _eyes(options)
    left, right = (picture(scene.surfaces, eye, options.blur) for eye in (left_eye, right_eye))
    right = options.gain * right**options.gamma + options.offset / 255
    left_disparity, visible = disparity(scene.surfaces, left_eye, right_eye)
    right_disparity, _ = disparity(scene.surfaces, right_eye, left_eye)
    camera, other, right_T_left = options.cameras()
    return StereoTruth(
        _counts(left, options, rng),
        _counts(right, options, rng),
        left_disparity,
        right_disparity,
        visible,
        camera,
        other,
        right_T_left,
    )


def _eyes(options: PairOptions) -> tuple[Eye, Eye]:
    x, y = (options.size[0] - 1) / 2, (options.size[1] - 1) / 2
    left = Eye(np.zeros(3), options.size, options.focal, (x, y))
    place = np.array([options.baseline, 0.0, 0.0])
    return left, Eye(place, options.size, options.focal, (x + options.doffs, y), options.row_shift, options.row_tilt)


def _counts(brightness: Array, options: PairOptions, rng: np.random.Generator) -> Array:
    """Return the image of a brightness (H, W, 3), 0 … 1, with noise, as whole numbers."""
    full = 2**options.depth - 1
    if not options.colour:
        brightness = brightness @ GRAY
    noise = rng.standard_normal(brightness.shape, dtype=np.float32) * (options.noise / 255)
    values = np.rint(np.clip(brightness + noise, 0, 1) * full)
    return np.asarray(values, dtype=np.uint8 if options.depth == 8 else np.uint16)
