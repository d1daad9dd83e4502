"""Clouds that tests look at."""

import numpy as np

from camcal.report.cloud_scene import CloudScene, gather
from camcal.stereo.depth import LEFT_CAMERA, VertexStream, vertex_type

RED, BLUE = (220, 20, 20), (20, 20, 220)
ROS = "left camera: x forward, y left, z up"


def stream_of(points, colours=None, sigma=None, *, unit="m", frame=LEFT_CAMERA, blocks=1):
    """Return points (N, 3) as a stream; colours: (N, 3) or one for all; sigma: (N,)."""
    vertices = np.zeros(len(points), vertex_type(colour=colours is not None, sigma=sigma is not None))
    vertices["x"], vertices["y"], vertices["z"] = np.asarray(points, np.float32).T
    if colours is not None:
        vertices["red"], vertices["green"], vertices["blue"] = np.broadcast_to(colours, (len(points), 3)).T
    if sigma is not None:
        vertices["sigma"] = sigma
    return VertexStream(len(points), vertices.dtype, np.array_split(vertices, blocks), unit, frame)


def scene_of(points, colours=None, sigma=None, **more) -> CloudScene:
    return gather(stream_of(points, colours, sigma, **more), most=10**9)


def square(middle, half, count):
    """Return the points (count², 3) of a square that faces the camera."""
    steps = np.linspace(-half, half, count)
    x, y = np.meshgrid(steps, steps)
    return np.stack([x.ravel(), y.ravel(), np.zeros(count**2)], axis=1) + middle


def two_squares():
    """Return points, colours and sigma of a red square at 2 m to the left and a larger blue one behind, to the right.

    The camera sees both under the same angle; seen from the front, the red one is half as large.
    """
    red, blue = square((-0.5, 0.1, 2.0), 0.3, 80), square((1.0, -0.2, 4.0), 0.6, 80)
    points = np.concatenate([red, blue])
    colours = np.repeat([RED, BLUE], 80 * 80, axis=0)
    return points, colours, 0.01 * points[:, 2] ** 2


def in_ros(points):
    """Return points (N, 3) of a camera's frame with x forward, y left and z up."""
    return np.stack([points[:, 2], -points[:, 0], -points[:, 1]], axis=1)


def middle_of(pixels, colour, tolerance=60):
    """Return the centre of mass (x, y) of the pixels (H, W, 3) that have about a colour, and how many they are."""
    rows, columns = np.nonzero((np.abs(pixels.astype(int) - colour) <= tolerance).all(axis=2))
    return (columns.mean(), rows.mean(), len(rows)) if len(rows) else (np.nan, np.nan, 0)
