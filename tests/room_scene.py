"""A room with a ball in it, painted in all three dimensions, as any lens sees it, and how far everything is."""

import cv2
import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera, resized
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose

LOW, HIGH = np.array([-2.2, -1.5, -2.0]), np.array([2.0, 1.4, 2.6])  # of the room, m
BALL, RADIUS = np.array([0.3, 0.2, 1.1]), 0.35
_HASH = np.array([73856093, 19349663, 83492791], np.uint64)
_SUBPIXELS = np.array([-0.25, 0.25])


def seen(camera: Camera, room_T_camera: Pose, finest: float = 0.03) -> tuple[np.ndarray, np.ndarray]:
    """Return the picture (H, W) uint8 that a camera takes, and the points (H, W, 3) it sees, in its frame, NaN beyond.

    finest: size of the smallest spots of the paint, m.
    """
    width, height = camera.image_size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    light = np.zeros((height, width))
    for down in _SUBPIXELS:
        for across in _SUBPIXELS:
            points = _hit(camera, room_T_camera, u + across, v + down)
            light += _paint(points, finest) / _SUBPIXELS.size**2
    points = room_T_camera.inverse().apply(_hit(camera, room_T_camera, u, v))
    return np.rint(np.nan_to_num(light) * 255).astype(np.uint8), points


def _hit(camera, room_T_camera, u, v):
    """Return the points (H, W, 3) in the room that pixels see."""
    rays = camera.unproject(np.column_stack([u.ravel(), v.ravel()])).directions @ room_T_camera.rotation.T
    eye = room_T_camera.translation
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = np.where(rays > 0, HIGH - eye, LOW - eye) / rays
    distance = np.nanmin(np.where(np.isfinite(walls), walls, np.inf), axis=1)
    to_ball = rays @ (BALL - eye)
    inside = to_ball**2 - (BALL - eye) @ (BALL - eye) + RADIUS**2
    with np.errstate(invalid="ignore"):
        near = to_ball - np.sqrt(inside)
    distance = np.where((inside > 0) & (near > 0), near, distance)
    return (eye + rays * distance[:, None]).reshape(*u.shape, 3)


def _paint(points, finest):
    """Return the brightness 0 … 1 of points: noise of four scales, the coarser the stronger."""
    total = np.full(points.shape[:-1], 0.5)
    for octave, strength in enumerate((0.22, 0.3, 0.3, 0.3)):
        total += strength * (_noise(points / (finest * 2**octave)) - 0.5)
    return np.clip(total, 0.0, 1.0)


def _noise(places):
    """Return values 0 … 1, random at whole numbers and linear between them."""
    known = np.nan_to_num(places)
    corner = np.floor(known)
    share = known - corner
    total = np.zeros(places.shape[:-1])
    for step in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(step, share, 1 - share), axis=-1)
        key = ((corner + step).astype(np.int64).astype(np.uint64) * _HASH).sum(axis=-1, dtype=np.uint64)
        key = (key ^ (key >> np.uint64(13))) * np.uint64(0x9E3779B97F4A7C15)
        total += weight * ((key >> np.uint64(40)).astype(float) / 2**24)
    return np.where(np.isfinite(places).all(axis=-1), total, np.nan)


SIZE = (160, 120)
CENTRE = [80.3, 58.9]
LENSES = {  # by the view that their images are rectified to, or by their field of view
    "pinhole": ("opencv5", [170.0, 171.0, *CENTRE, -0.2, 0.06, 1e-3, -5e-4, 0.0]),
    "120 degrees": ("kannala_brandt4", [76.2, 76.5, *CENTRE, 0.02, -0.005, 0.001, 0.0]),
    "cylindrical": ("kannala_brandt4", [82.0, 82.5, *CENTRE, 0.02, -0.005, 0.001, 0.0]),
    "latlon": ("kannala_brandt4", [50.8, 51.0, *CENTRE, 0.02, -0.005, 0.001, 0.0]),
}
BESIDE = Pose.from_vector(np.array([0.01, -0.03, 0.005]), np.array([-0.3, 0.005, 0.01]))
BELOW = Pose.from_vector(np.array([0.02, 0.01, -0.005]), np.array([0.004, -0.3, 0.01]))
ROOM_T_LEFT = Pose.from_vector(np.array([0.02, 0.1, 0.01]), np.array([-0.3, 0.0, -1.0]))


class RoomRig:
    """A rig in a room: its file, its pictures, and the points (H, W, 3) that the left one shows.

    widest: half of the field of view across, rad.

    scale: of its pictures, which have 160 x 120 pixels at 1. coarse: render so many times smaller, and enlarge.
    """

    def __init__(self, folder, kind, right_T_left, scale=1.0, coarse=1):
        model, values = LENSES[kind]
        size = round(SIZE[0] * scale), round(SIZE[1] * scale)
        small = size[0] // coarse, size[1] // coarse
        std = np.abs(values) * 3e-4 + 1e-6
        cameras = [resized(Camera(model_named(model), SIZE, np.array(values) * each), size) for each in (1.0, 1.004)]
        entries = [CameraEntry(Camera(each.model, size, each.parameters, np.diag(std**2))) for each in cameras]
        transform = Transform(right_T_left, np.diag(np.array([1e-4, 1e-4, 2e-4, 2e-4, 2e-4, 1e-4]) ** 2))
        self.camera = cameras[0]
        edge = self.camera.unproject(np.array([[0.0, size[1] / 2]])).directions[0]
        self.widest = float(np.arctan2(np.hypot(edge[0], edge[1]), edge[2]))
        self.file, self.left, self.right = folder / "rig.yaml", folder / "left.png", folder / "right.png"
        file = CameraFile(dict(zip(("left", "right"), entries, strict=True)), {"right_T_left": transform})
        native.write(self.file, file)
        finest = 0.06 * coarse / scale
        poses = ROOM_T_LEFT, ROOM_T_LEFT @ right_T_left.inverse()
        for path, camera, pose in zip((self.right, self.left), cameras[::-1], poses[::-1], strict=True):
            picture, self.points = seen(resized(camera, small), pose, finest)
            if coarse > 1:
                picture = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(str(path), picture)


def errors(cloud, camera, truth):
    """Return the relative errors of the distances of a cloud's points from the camera, whose picture shows `truth`."""
    points = np.column_stack([cloud.vertices[name] for name in "xyz"]).astype(float)
    columns, rows = np.rint(camera.project(points).pixels).astype(int).T
    inside = (columns >= 0) & (columns < SIZE[0]) & (rows >= 0) & (rows < SIZE[1])
    there = np.linalg.norm(truth[rows[inside], columns[inside]], axis=1)
    return np.linalg.norm(points[inside], axis=1) / there - 1
