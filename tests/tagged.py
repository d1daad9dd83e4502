"""Photographs of markers with known truth, integrated over every pixel from their outlines."""

import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry.pose import Pose
from camcal.simulate.render import Exposure, develop, draw, light, outlines, piece_length
from camcal.targets.markers import OPENCV, tag_corners
from camcal.targets.pattern import Pattern, family_named

QUIET = 1.5  # cells of white around a marker
FACING = np.diag([1.0, -1.0, -1.0])  # an upright tag that looks at the camera: y up and z towards it


def pinhole(size=(640, 480), focal=600.0):
    return Camera(model_named("pinhole"), size, np.array([focal, focal, size[0] / 2 - 0.5, size[1] / 2 - 0.5]))


def facing(x, y, z, turn=(0.0, 0.0, 0.0)):
    """The pose of a tag (opencv frame) whose upright picture is turned by a rotation vector, in radians."""
    return Pose(Pose.from_vector(np.array(turn), np.zeros(3)).rotation @ FACING, np.array([x, y, z]))


def ink_as_printed(family, marker):
    known = family_named(family)
    ink = known.drawing(marker).ink
    return ink[::-1, ::-1] if known.turned else ink


def photograph(camera, tags, *, family="tag36h11", size=0.05, seed=0, exposure=None):
    """Return the image (H, W) of tags [(id, camera_T_tag in the opencv frame)]."""
    exposure = exposure or Exposure(blur_px=0.7, noise_dn=2.0, gradient=0.1)
    rng = np.random.default_rng(seed)
    brightness = np.full(camera.image_size[::-1], exposure.background)
    for marker, camera_T_tag in tags:
        brightness += sheet(camera, ink_as_printed(family, marker), camera_T_tag, size, exposure)
    return develop(brightness * light(camera.image_size, exposure, rng.uniform(0, 2 * np.pi)), exposure, rng)


def sheet(camera, ink, camera_T_tag, size, exposure):
    """Return what one sheet of paper adds to the brightness of the background."""
    cells = len(ink)
    lines = size * np.concatenate([[-QUIET / cells], np.linspace(0, 1, cells + 1), [1 + QUIET / cells]]) - size / 2
    edges, jumps = outlines(Pattern(lines, lines, np.pad(ink, 1, constant_values=1.0)), exposure)
    points = np.concatenate([edges * [1, -1], np.zeros((*edges.shape[:2], 1))], axis=2)  # rows go down, y goes up
    ends = project(camera, camera_T_tag, points)
    count = 1 + int(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max() / piece_length(exposure.blur_px))
    share = np.linspace(0, 1, count + 1)[:, None]
    path = project(camera, camera_T_tag, points[:, None, 0] + share * (points[:, None, 1] - points[:, None, 0]))
    pen = np.zeros((len(jumps), count + 1))
    pen[:, :count] = jumps[:, None]
    return draw(camera.image_size, path.reshape(-1, 2), pen.ravel()[:-1], exposure.blur_px)


def project(camera, camera_T_tag, points):
    projection = camera.project(camera_T_tag.apply(points).reshape(-1, 3))
    assert projection.valid.all()
    return projection.pixels.reshape(*points.shape[:-1], 2)


def true_corners(camera, camera_T_tag, size=0.05):
    return project(camera, camera_T_tag, tag_corners(size, OPENCV))
