"""Random pairs of cameras and a judge of their rectification, with formulas of their own: nothing here asks camcal.

The judge draws points at several distances that both cameras see, and counts how many of them both rectified images
hold; it looks for empty, turned and mirrored images and for points that are not in one row.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

Array = np.ndarray

KINDS = ("parallel", "toed-in", "vertical", "swapped", "mixed lenses", "upside-down", "axial", "oblique")
ORIENTATIONS = ("any roll", "any baseline", "quarter turns")
SIZES = ((640, 480), (752, 480), (1024, 1024), (1280, 720), (1920, 1200))
BROWN, FISHEYE = "opencv5", "kannala_brandt4"
POINTS = 4000  # rays that are asked for at every distance
DISTANCES = (3.0, 10.0, 100.0, 1e6)  # baselines
KEPT = 0.85
EMPTY = 0.1  # of the pixels with a source, below which an image is empty
WRONG = 0.1  # of the pixels that are turned by more than 90° or mirrored, above which the image is


@dataclass(frozen=True)
class Lens:
    """A camera: model, size, fx fy cx cy, coefficients, half its field (rad), and the radius of its image circle."""

    model: str
    size: tuple[int, int]
    core: tuple[float, float, float, float]
    coefficients: tuple[float, ...]
    half_field: float
    circle_radius: float | None = None

    @property
    def matrix(self) -> Array:
        fx, fy, cx, cy = self.core
        return np.array([(fx, 0, cx), (0, fy, cy), (0, 0, 1)])

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return the pixels (N, 2) of points (N, 3), and which of them are in the image."""
        fx, fy, cx, cy = self.core
        radius = np.hypot(points[:, 0], points[:, 1])
        angle = np.arctan2(radius, points[:, 2])
        seen = angle <= min(self.half_field * 1.001, np.pi - 1e-3)
        if self.model == FISHEYE:
            square = angle**2
            series = 1 + square * np.polyval(self.coefficients[::-1], square)
            scale = angle * series / np.where(radius > 0, radius, 1)
            x, y = points[:, 0] * scale, points[:, 1] * scale
        else:
            depth = np.where(seen, points[:, 2], 1)
            x, y = points[:, 0] / depth, points[:, 1] / depth
            k1, k2, p1, p2, k3 = self.coefficients
            square = x * x + y * y
            radial = 1 + square * (k1 + square * (k2 + square * k3))
            x, y = (
                x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
                y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
            )
        pixels = np.column_stack([fx * x + cx, fy * y + cy])
        seen &= ((pixels >= 0) & (pixels <= np.array(self.size) - 1)).all(axis=1)
        if self.circle_radius is not None:
            seen &= np.hypot(*(pixels - (cx, cy)).T) <= self.circle_radius
        return pixels, seen

    def rays(self, pixels: Array) -> Array:
        """Return the unit rays (N, 3) of pixels (N, 2): the inverse of `project`, by iteration."""
        fx, fy, cx, cy = self.core
        x_d, y_d = ((pixels - (cx, cy)) / (fx, fy)).T
        if self.model == FISHEYE:
            radius = np.hypot(x_d, y_d)
            angle = radius.copy()
            for _ in range(20):
                square = angle**2
                powers = angle[:, None] ** (2 * np.arange(5))
                value = angle * (1 + square * np.polyval(self.coefficients[::-1], square))
                slope = powers @ (np.array([1, *self.coefficients]) * (2 * np.arange(5) + 1))
                angle = angle - (value - radius) / slope
            share = np.sin(angle) / np.where(radius > 0, radius, 1)
            return np.column_stack([x_d * share, y_d * share, np.cos(angle)])
        k1, k2, p1, p2, k3 = self.coefficients
        x, y = x_d, y_d
        for _ in range(60):
            square = x * x + y * y
            radial = 1 + square * (k1 + square * (k2 + square * k3))
            x, y = (
                (x_d - 2 * p1 * x * y - p2 * (square + 2 * x * x)) / radial,
                (y_d - p1 * (square + 2 * y * y) - 2 * p2 * x * y) / radial,
            )
        rays = np.column_stack([x, y, np.ones_like(x)])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)


@dataclass(frozen=True)
class RandomRig:
    """Two lenses and right_T_left; first and second are left and right unless the kind says otherwise."""

    kind: str
    lenses: tuple[Lens, Lens]
    rotation: Array
    translation: Array

    @property
    def baseline(self) -> float:
        return float(np.linalg.norm(self.translation))

    @property
    def second_centre(self) -> Array:
        return -self.rotation.T @ self.translation


def random_rigs(count: int, seed: int) -> list[RandomRig]:
    """Return rigs of every kind in turn."""
    rng = np.random.default_rng(seed)
    rigs = []
    while len(rigs) < count:
        rig = _random_rig(KINDS[len(rigs) % len(KINDS)], rng)
        if rig.kind in ("axial", "oblique") or has_common_field(rig, rng):
            rigs.append(rig)
    return rigs


def _random_rig(kind: str, rng: np.random.Generator) -> RandomRig:
    first = random_lens(rng)
    second = random_lens(rng) if kind == "mixed lenses" else _sibling(first, rng)
    small = np.radians(rng.normal(0, 1.0, 3))
    rotation = cv2.Rodrigues(small)[0]
    direction = np.array([1.0, *rng.normal(0, 0.05, 2)])
    if kind == "toed-in" or (kind in ("swapped", "mixed lenses") and rng.random() < 0.5):
        inwards = np.radians(rng.uniform(2, 30))
        rotation = _about(1, inwards) @ rotation
        direction = _about(1, -inwards * rng.uniform(0.2, 0.8)).T @ direction
    if kind == "vertical":
        direction = direction[[1, 0, 2]] * rng.choice([-1, 1])
    if kind == "swapped":
        direction = -direction
        rotation = rotation.T
    if kind == "upside-down":
        rotation = _about(2, np.pi) @ rotation
    if kind == "axial":
        direction = _about(1, np.radians(rng.uniform(-8, 8))) @ np.array([0, 0, rng.choice([-1.0, 1.0])])
    if kind == "oblique":
        direction = _about(1, -np.radians(rng.uniform(25, 75)) * rng.choice([-1, 1])) @ direction
    centre = direction / np.linalg.norm(direction) * rng.uniform(0.03, 0.5)
    return RandomRig(kind, (first, second), rotation, -rotation @ centre)


def rigs_of_any_orientation(count: int, seed: int) -> list[RandomRig]:
    """Return rigs with a common field whose cameras have any roll, any baseline and axes up to 40° apart."""
    rng = np.random.default_rng(seed)
    rigs = []
    while len(rigs) < count:
        kind = ORIENTATIONS[len(rigs) % len(ORIENTATIONS)]
        first = random_lens(rng)
        second = _sibling(first, rng) if rng.random() < 0.7 else random_lens(rng)
        rolls = rng.uniform(-np.pi, np.pi, 2)
        if kind == "quarter turns":
            rolls = np.round(rolls / (np.pi / 2)) * np.pi / 2 + rng.normal(0, 0.03, 2)
        half = np.radians(rng.uniform(0, 40 if kind == "any baseline" else 8)) / 2
        azimuth = rng.uniform(0, 2 * np.pi)
        lean = cv2.Rodrigues(half * np.array([np.cos(azimuth), np.sin(azimuth), 0]))[0]
        direction = rng.normal(size=3) * ([1, 1, 1] if kind == "any baseline" else [1, 1, 0.15])
        turns = _about(2, rolls[0]) @ lean.T, _about(2, rolls[1]) @ lean  # of the cameras from the mean view
        rotation = turns[1] @ turns[0].T
        centre = turns[0] @ direction / np.linalg.norm(direction) * rng.uniform(0.03, 0.5)
        rig = RandomRig(kind, (first, second), rotation, -rotation @ centre)
        if has_common_field(rig, rng):
            rigs.append(rig)
    return rigs


def _about(axis: int, angle: float) -> Array:
    return cv2.Rodrigues(angle * np.eye(3)[axis])[0]


def random_lens(rng: np.random.Generator) -> Lens:
    """Return a lens of a diagonal field of 5° to 200°, or a circle of as much in its image."""
    size = SIZES[rng.integers(len(SIZES))]
    half = np.radians(rng.uniform(5, 200)) / 2
    model = FISHEYE if half > np.radians(55) or rng.random() < 0.25 else BROWN
    circle = min(size) / 2 * 0.98 if model == FISHEYE and half > np.radians(70) and rng.random() < 0.5 else None
    corner = np.hypot(*size) / 2 if circle is None else circle
    centre = ((np.array(size) - 1) / 2 + rng.normal(0, 0.005, 2) * size[0]).tolist()
    if model == FISHEYE:
        bend = rng.uniform(-0.15, 0.05) / half**2  # of the radius at the edge
        coefficients = (float(bend), 0.0, 0.0, 0.0)
        focal = corner / (half * (1 + bend * half**2))
    else:
        edge = np.tan(half)
        bend = rng.uniform(-0.12, 0.06) / edge**2
        coefficients = (float(bend), 0.0, *rng.normal(0, 2e-4, 2).tolist(), 0.0)
        focal = corner / (edge * (1 + bend * edge**2))
    aspect = 1 + rng.normal(0, 0.002)
    # the principal point is off the middle, so that the farthest corner sees more
    return Lens(model, size, (focal, focal * aspect, *centre), coefficients, half * 1.04, circle)


def _sibling(lens: Lens, rng: np.random.Generator) -> Lens:
    """Return another piece of the same lens."""
    fx, fy, cx, cy = lens.core
    scale = 1 + rng.normal(0, 0.003)
    moved = rng.normal(0, 0.004 * lens.size[0], 2)
    core = (fx * scale, fy * scale, cx + moved[0], cy + moved[1])
    return Lens(lens.model, lens.size, core, lens.coefficients, lens.half_field, lens.circle_radius)


def has_common_field(rig: RandomRig, rng: np.random.Generator) -> bool:
    """Return whether a twentieth of what the narrower camera sees is common at some distance."""
    return max(share for _, share in _common_points(rig, rng, 600)) > 0.05


def _common_points(rig: RandomRig, rng: np.random.Generator, count: int = POINTS) -> Iterator[tuple[Array, float]]:
    """Yield points (N, 3) in the frame of the first camera that both see, and their share, by distance.

    Rays are of the narrower camera's field, alike over the sphere. Besides fixed distances there are those around where
    the optical axes meet.
    """
    narrow = int(rig.lenses[1].half_field < rig.lenses[0].half_field)
    lens = rig.lenses[narrow]
    for distance in (*DISTANCES, *_meeting(rig, narrow)):
        cosine = rng.uniform(np.cos(min(lens.half_field, np.pi)), 1, count)
        azimuth, sine = rng.uniform(0, 2 * np.pi, count), np.sqrt(1 - cosine**2)
        rays = np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])
        own = rays * distance * rig.baseline
        first = own if narrow == 0 else (own - rig.translation) @ rig.rotation
        second = first @ rig.rotation.T + rig.translation
        seen_by_own = lens.project(own)[1]
        seen = rig.lenses[0].project(first)[1] & rig.lenses[1].project(second)[1]
        yield first[seen], float(seen.sum() / max(1, seen_by_own.sum()))


def _meeting(rig: RandomRig, side: int) -> list[float]:
    """Return distances from a camera, in baselines, around where the optical axes meet, if they do."""
    one, other = np.array([0, 0, 1.0]), rig.rotation.T @ [0, 0, 1.0]
    system = np.column_stack([one, -other])
    where, *_ = np.linalg.lstsq(system, rig.second_centre, rcond=None)
    apart = np.linalg.norm(system @ where - rig.second_centre)  # of axes that pass each other
    if np.linalg.norm(np.cross(one, other)) < 0.02 or min(where) <= 0 or apart > rig.baseline / 2:
        return []
    return [share * where[side] / rig.baseline for share in (0.8, 1.0, 1.5)]


@dataclass(frozen=True)
class Image:
    """One rectified image: its size, rect_R_camera, and the pixels of points in rectified axes and rays of pixels."""

    size: tuple[int, int]
    rotation: Array
    pixels: Callable[[Array], Array]
    rays: Callable[[Array], Array]


@dataclass(frozen=True)
class Rectified:
    """What a program made of a rig: the images of its first and second camera, rows or columns in common."""

    images: tuple[Image, Image]
    focals: tuple[float, ...]
    axis: int


@dataclass(frozen=True)
class RigVerdict:
    """What the judge found; kept: of the points that both cameras see, over all distances. row_error: px."""

    kept: float
    problems: tuple[str, ...]
    row_error: float

    @property
    def is_right(self) -> bool:
        return not self.problems and self.kept >= KEPT


def judge(rig: RandomRig, found: Rectified, seed: int) -> RigVerdict:
    """Return the verdict on a rectification."""
    rng = np.random.default_rng(seed)
    faults = []
    if not all(np.isfinite(focal) and focal > 0 for focal in found.focals):
        return RigVerdict(0.0, ("negative focal length",), np.nan)
    sources = [_source_pixels(lens, image) for lens, image in zip(rig.lenses, found.images, strict=True)]
    if min(seen.mean() for _, seen in sources) < EMPTY:
        faults.append("empty")
    else:
        turned, mirrored = _orientation(rig.lenses[0], found.images[0])
        if turned > WRONG:
            faults.append("turned")
        if mirrored > WRONG:
            faults.append("mirrored")
    held, count, error = 0.0, 0.0, 0.0
    for points, share in _common_points(rig, rng):
        if share == 0:
            continue
        second = points @ rig.rotation.T + rig.translation
        with np.errstate(all="ignore"):
            pixels = [
                image.pixels(own @ image.rotation.T) for image, own in zip(found.images, (points, second), strict=True)
            ]
            inside = np.all(
                [
                    ((each > -0.5) & (each < np.array(image.size) - 0.5)).all(axis=1)
                    for each, image in zip(pixels, found.images, strict=True)
                ],
                axis=0,
            )
        held, count = held + inside.sum(), count + len(points)
        if inside.any():
            apart = np.abs(pixels[0] - pixels[1])[inside, 1 - found.axis]
            error = max(error, float(apart.max()))
    if error > 1e-3:
        faults.append("rows")
    return RigVerdict(held / count if count else 0.0, tuple(faults), error)


def _source_pixels(lens: Lens, image: Image, steps: int = 40, offset: Array | None = None) -> tuple[Array, Array]:
    """Return where pixels all over a rectified image come from, and which have a source."""
    width, height = image.size
    grid = np.meshgrid(np.linspace(0, width - 1, steps), np.linspace(0, height - 1, steps))
    pixels = np.column_stack([axis.ravel() for axis in grid]) + (0 if offset is None else offset)
    return lens.project(image.rays(pixels) @ image.rotation)


def _orientation(lens: Lens, image: Image) -> tuple[float, float]:
    """Return the shares of a rectified image whose content is turned by more than 90°, and mirrored."""
    here, seen = _source_pixels(lens, image)
    right, also = _source_pixels(lens, image, offset=np.array([0.5, 0]))
    below, too = _source_pixels(lens, image, offset=np.array([0, 0.5]))
    seen = seen & also & too
    if not seen.any():
        return 1.0, 1.0
    across, down = (right - here)[seen], (below - here)[seen]
    upright = across[:, 0] / np.linalg.norm(across, axis=1) + down[:, 1] / np.linalg.norm(down, axis=1)
    determinant = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
    return float((upright < 0).mean()), float((determinant < 0).mean())


def median_turn(lens: Lens, image: Image) -> float:
    """Return by what angle (degrees, median) what a lens sees is turned in its rectified image."""
    here, seen = _source_pixels(lens, image)
    beside, also = _source_pixels(lens, image, offset=np.array([0.5, 0]))
    across = (beside - here)[seen & also]
    return float(np.degrees(np.median(np.abs(np.arctan2(across[:, 1], across[:, 0]))))) if len(across) else 180.0
