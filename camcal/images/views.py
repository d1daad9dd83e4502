"""Cameras of undistorted images: a cropped or complete pinhole view, or a panorama for wide lenses.

What is shown is a box (left, top, right, bottom) inside or around the region of the plane that the lens sees.
"""

import numpy as np

from camcal.arrays import Array
from camcal.cameras import panoramic
from camcal.cameras.catalogue import model_named
from camcal.cameras.lens import CameraModel
from camcal.cameras.model import Camera, require_central
from camcal.cameras.validity import ImageCircle, rim
from camcal.errors import InvalidInput
from camcal.images.options import PINHOLE, WIDEST_PINHOLE_DEG, ViewOptions, refuse_pinhole, widest_deg
from camcal.images.remap import Trace

PANORAMAS = {model.name: model for model in panoramic.MODELS}

_PER_EDGE = 256  # samples of each edge of the image: between two of them it bends by less than 0.01 px
_DENSEST = 16  # times that
_WIDEST_PINHOLE = np.radians(WIDEST_PINHOLE_DEG)
_SHRINKS = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.05, 0.1, 0.2)
_CHECKED = 64  # pixels a side that are asked whether a crop holds


def make_view(camera: Camera, options: ViewOptions | None = None, circle: ImageCircle | None = None) -> Camera:
    """Return the camera of the view, looking along the same axis; circle: the camera's image circle.

    Raises InvalidInput if a pinhole is to hold what it cannot, with the projections that can.
    """
    options = options or ViewOptions()
    size = options.size or camera.image_size
    if not camera.model.is_central and (options.projection != PINHOLE or options.fov_deg is not None):
        require_central(camera.model)
    if options.keep_k:
        model, parameters = _straight_lens(camera, camera.parameters[:4])
        scale = size[0] / camera.image_size[0], size[1] / camera.image_size[1]
        return Camera(model, size, model.rescale(parameters, scale, (0.0, 0.0)))
    if options.projection == PINHOLE and options.fov_deg is None:
        return _crop(camera, circle, options.alpha or 0.0, size, stretch=options.stretch)
    fov_deg = options.fov_deg
    if fov_deg is None:  # what the lens sees across
        fov_deg = min(widest_deg(options.projection), np.degrees(seen_across(camera, circle)))
    fov = np.radians(fov_deg)
    model = model_named(PINHOLE) if options.projection == PINHOLE else PANORAMAS[options.projection]
    half_width = np.tan(fov / 2) if options.projection == PINHOLE else PANORAMAS[options.projection].half_width(fov)
    return Camera(model, size, model.start(size, size[0] / 2 / half_width))


def _straight_lens(camera: Camera, core: Array) -> tuple[CameraModel, Array]:
    """Return the lens without distortion whose images have straight lines, with parameters that begin with these (4,):
    a pinhole, or with parallel rays such a lens.
    """
    model = model_named(PINHOLE) if camera.model.is_central else camera.model
    return model, np.concatenate([core, np.zeros(len(model.parameter_names) - len(core))])


def seen_across(camera: Camera, circle: ImageCircle | None = None) -> float:
    """Return the angle (rad) a lens sees across the middle of its image: twice the larger side of its axis."""
    ends = np.array([[0.0, camera.value("cy")], [camera.image_size[0] - 1.0, camera.value("cy")]])
    ends = ends if circle is None else circle.clipped(np.array([camera.value("cx"), camera.value("cy")]), ends)
    angles = _angles(camera.unproject(ends).directions)
    if not np.isfinite(angles).any():  # the lens model ends before the image does
        angles = _angles(_outline(camera, circle))
    return float(2 * np.nanmax(angles))


def _crop(camera: Camera, circle: ImageCircle | None, alpha: float, size: tuple[int, int], *, stretch: bool) -> Camera:
    """Return the pinhole between the largest crop without an empty pixel and the smallest frame around all pixels."""
    if min(size) < 2:
        raise _no_crop(size)
    shape = (size[0] - 1) / (size[1] - 1) * camera.value("fy") / camera.value("fx")
    elongation = max(shape, 1 / shape)
    if elongation == np.inf:  # a focal length next to zero
        raise _no_crop(size)
    # The ends of an elongated crop fall between samples of the outline unless there are more of them.
    rays = _outline(camera, circle, _PER_EDGE * min(_DENSEST, 1 + int(elongation / 8)))
    widest = 2 * float(_angles(rays).max())
    in_front = _angles(rays) < _WIDEST_PINHOLE / 2
    if not in_front.any() or (alpha > 0 and not in_front.all()):
        refuse_pinhole(widest)
    outline = rays[in_front, :2] / rays[in_front, 2:]
    inner = largest_box(outline, None if stretch else shape)
    if not _angles(np.append(inner[2:], 1.0)[None])[0] < _WIDEST_PINHOLE / 2:
        refuse_pinhole(widest)
    inner = _without_empty_pixels(camera, circle, inner, size)
    outer = enclosing_box(outline, None if stretch else shape)
    return _fill(camera, (1 - alpha) * inner + alpha * outer, size)


def _without_empty_pixels(camera: Camera, circle: ImageCircle | None, box: Array, size: tuple[int, int]) -> Array:
    """Return the box, shrunk about its middle until every pixel of its view has a source: the outline is sampled."""
    middle = (box[:2] + box[2:]) / 2
    for shrink in _SHRINKS:
        smaller = np.tile(middle, 2) + (1 - shrink) * (box - np.tile(middle, 2))
        if _is_full(Trace(camera, _fill(camera, smaller, size), circle=circle)):
            return smaller
    raise _no_crop(size)


def _no_crop(size: tuple[int, int]) -> InvalidInput:
    return InvalidInput("no crop of {}x{} without an empty pixel was found; use --keep-k or --fov".format(*size))


def _is_full(trace: Trace) -> bool:
    """Return whether the pixels along the edges of a view, and a grid between them, all have a source."""
    width, height = trace.view.image_size
    across, down = np.arange(width), np.arange(height)
    grid = np.linspace(0, width - 1, _CHECKED), np.linspace(0, height - 1, _CHECKED)[:, None]
    edges = (across, np.array([[0], [height - 1]])), (np.array([0, width - 1]), down[:, None])
    last = np.array(trace.source.image_size)[:, None, None] - 1
    positions = (trace.positions(x, y) for x, y in (grid, *edges))
    return all(bool(((where >= 0) & (where <= last)).all()) for where in positions)


def _fill(camera: Camera, box: Array, size: tuple[int, int]) -> Camera:
    """Return the view whose outermost pixel centres are the edges of a box (left, top, right, bottom) at Z = 1."""
    if not (box[2:] - box[:2] > _NARROWEST).all():
        raise _no_crop(size)
    focal = (np.array(size) - 1) / (box[2:] - box[:2])
    model, parameters = _straight_lens(camera, np.concatenate([focal, -box[:2] * focal]))
    return Camera(model, size, parameters)


def _outline(camera: Camera, circle: ImageCircle | None, per_edge: int = _PER_EDGE) -> Array:
    """Return points (N, 3) around all that the camera sees, at distance 1."""
    rays = camera.unproject(rim(camera, per_edge, circle)[0])
    return np.asarray(rays.at()[rays.valid])


def _angles(rays: Array) -> Array:
    """Return the angles (N,) in rad of rays (N, 3) from the optical axis."""
    return np.asarray(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))


_NARROWEST = 1e-12  # of a box at Z = 1: a lens of the longest focal length in pixels shows a hundred times as much
_AROUND = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if (x, y) != (0, 0)], dtype=float)
_PULL = 0.01  # of its distance from the axis that a box must gain in half its height to be moved there
_FINE, _COARSE = 1e-7, 1e-3  # of the box: where the search for its place ends, and for its aspect
_THIN = 0.1  # of the extent of the outline, more than from one sample to the next: where the search starts at least
_ASPECTS = np.geomspace(1 / 3, 3, 21)  # times that of the outline
_EVERY = 8  # samples of the outline from one to the next that tell aspects from each other


def largest_box(outline: Array, aspect: float | None) -> Array:
    """Return the largest box (4,) inside an outline (N, 2) around the origin.

    aspect: its width by its height; None lets it have any, and the largest area wins.
    """
    if aspect is not None:
        return _box(outline, aspect)[0]
    low, high = outline.min(axis=0), outline.max(axis=0)
    aspect = (high[0] - low[0]) / (high[1] - low[1])
    for choice in (_ASPECTS, _ASPECTS**0.1, _ASPECTS**0.01):
        areas = [_box(outline[::_EVERY], aspect * factor, _COARSE)[1] for factor in choice]
        aspect *= choice[int(np.argmax(areas))]
    return _box(outline, aspect)[0]


def enclosing_box(outline: Array, aspect: float | None) -> Array:
    """Return the smallest box (4,) around an outline (N, 2); aspect: its width by its height, None any."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    if aspect is not None:
        height = max(half[1], half[0] / aspect)
        half = np.array([height * aspect, height])
    return np.concatenate([middle - half, middle + half])


def _box(outline: Array, aspect: float, fine: float = _FINE) -> tuple[Array, float]:
    """Return the largest box of one aspect, and its area.

    Seen with one axis scaled, a box is a ball of the largest-coordinate distance: its half height is the distance
    from its middle to the outline, and the middle is moved while that grows. Where it hardly does, as along the
    longer sides of a barrel, the middle stays near the axis. It never leaves the extent of the outline, beyond which
    the distance grows for ever.
    """
    stretch = np.array([aspect, 1.0])
    points = outline / stretch
    low, high = points.min(axis=0), points.max(axis=0)
    middle, worth = np.zeros(2), float(np.abs(points).max(axis=1).min())
    start = max(worth, _THIN * float((high - low).max()))  # the axis may lie on the outline
    step, smallest = start / 2, fine * start
    while step > smallest:
        candidates = middle + step * _AROUND
        distances = np.abs(points - candidates[:, None]).max(axis=2).min(axis=1)
        within = ((candidates > low) & (candidates < high)).all(axis=1)
        worths = np.where(within, distances - _PULL * np.abs(candidates).sum(axis=1), -np.inf)
        best = int(np.argmax(worths))
        if worths[best] > worth:
            middle, worth = candidates[best], float(worths[best])
        else:
            step /= 2
    reach = float(np.abs(points - middle).max(axis=1).min())
    half = reach * stretch
    return np.concatenate([middle * stretch - half, middle * stretch + half]), 4 * reach * reach * aspect
