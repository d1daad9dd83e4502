"""Pictures of point clouds without a display: one view, a montage of four, or a video of an orbit.

Points are drawn as small discs, near ones over far ones, with numpy alone. Over them stand a caption, a scale bar and
the legend of their colours. Videos are GIF for any page, MP4 for longer ones.
"""

from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from PIL import Image

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.files import replacing
from camcal.report.cloud_scene import CloudScene, View, view_of
from camcal.report.colour_scale import ColourScale, Paint, turbo_table

# labels
_DPI = 100
_FONT = 1 / 55  # of the smaller side of the picture
_SMALLEST_FONT = 9.0  # pixels
_INK = "0.15"
_OPACITY = 0.85
_PAPER: dict[str, Any] = {"facecolor": "white", "alpha": _OPACITY, "edgecolor": "none", "pad": 2.5}
_BAR = 0.22  # longest scale bar as a share of the width

# points
_OVERLAP = 0.75  # radius of a disc in spacings: 0.71 would just close a square grid
_LARGEST = 12  # pixels
_NEAREST = 0.02  # of the distance to the centre; what is nearer to the viewer is not drawn
_NEIGHBOURS = 5  # drawn neighbours of eight that make an empty pixel a gap
_GAP = 0.02  # how much the depth of these neighbours may differ, as a share
_SHADE = 12.0  # how fast a step in depth darkens what lies behind it
_DARKEST = 0.45
_NOTHING = -1
_DEEPEST = 0.1  # step, as a share of the distance, that darkens most
_CROSS = [(0, -2), (0, -1), (0, 1), (0, 2), (-2, 0), (-1, 0), (1, 0), (2, 0)]
_RING = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]

MONTAGE = ("camera", "30,22", "top", "side")
_BACKGROUND = (228, 231, 235)  # white walls stand out from it
_LINE = 2  # pixels between the pictures of a montage
_LIMITS = (32, 8192)  # pixels of a side

# videos
_PER_SECOND = 20  # a GIF counts in hundredths of a second
_CODEC = "mp4v"  # the one that every build of OpenCV can write into an MP4


@dataclass(frozen=True)
class Labels:
    """A caption; the unit of the cloud; pixels per unit for a scale bar, None in perspective; a scale and its name."""

    caption: str
    unit: str
    pixels_per_unit: float | None = None
    scale: ColourScale | None = None
    scale_name: str = ""


@dataclass(frozen=True, eq=False)
class Drawn:
    """Which point every pixel shows (H, W), -1 for none, and how far away it is (H, W), infinite for none."""

    index: Array
    distance: Array


def draw(scene: CloudScene, view: View, size: tuple[int, int], point_size: float = 1.0) -> Drawn:
    """Return what a view of the points shows, size (width, height).

    point_size: factor of the size of the points, which at 1 closes the surfaces. Hidden points are hidden.
    """
    across, down, distance, order = _project(scene, view, size)
    radius = _radii(scene, view, size, distance, order) * point_size
    column, row = (np.floor(value).astype(np.int64) for value in (across, down))
    classes = np.clip(np.rint(radius), 0, _LARGEST).astype(np.int64)
    rank = np.full(size[::-1], _NOTHING, np.int32)
    for pixels in np.unique(classes).tolist():
        chosen = np.flatnonzero(
            (classes == pixels)
            & (column >= -pixels)
            & (column < size[0] + pixels)
            & (row >= -pixels)
            & (row < size[1] + pixels)
        )
        layer = np.full((size[1] + 2 * pixels, size[0] + 2 * pixels), _NOTHING, np.int32)
        layer[row[chosen] + pixels, column[chosen] + pixels] = chosen  # of one pixel the last stays: the nearest
        np.maximum(rank, _discs(layer, pixels)[pixels : pixels + size[1], pixels : pixels + size[0]], out=rank)
    _close_gaps(rank, distance)
    shown = rank >= 0
    drawn = Drawn(np.full(rank.shape, _NOTHING, np.int64), np.full(rank.shape, np.inf, np.float32))
    drawn.index[shown], drawn.distance[shown] = order[rank[shown]], distance[rank[shown]]
    return drawn


def _project(scene: CloudScene, view: View, size: tuple[int, int]) -> tuple[Array, Array, Array, Array]:
    """Return columns, rows and distances (M,) of the points before the viewer, the farthest first, and their places."""
    beside = (scene.seen - view.eye.astype(np.float32)) @ view.axes.T.astype(np.float32)
    before = np.flatnonzero(beside[:, 2] > _NEAREST * view.distance)
    order = before[np.argsort(-beside[before, 2], kind="stable")]
    right, below, distance = beside[order].T
    scale = view.focal(size) / (view.distance if view.parallel else distance)
    return right * scale + size[0] / 2, below * scale + size[1] / 2, distance, order


def _radii(scene: CloudScene, view: View, size: tuple[int, int], distance: Array, order: Array) -> Array:
    """Return the radius of every disc, pixels, beyond the pixel in which the point lies."""
    spacing, grows = scene.spacing
    away = view.distance if view.parallel else distance
    rays = np.linalg.norm(scene.seen[order], axis=1) if grows else np.ones(len(order))
    radii: Array = _OVERLAP * spacing * rays * view.focal(size) / away - 0.25
    return radii


def _discs(layer: Array, radius: int) -> Array:
    """Return the largest value of a layer (H, W) within a disc around every pixel."""
    found, rows, reach = layer.copy(), layer.copy(), 0
    half_widths = [(int(np.sqrt(radius * radius + radius - dy * dy)), dy) for dy in range(radius + 1)]
    for half_width, dy in sorted(half_widths):
        while reach < half_width:
            reach += 1
            _raise_to(rows, layer, reach, axis=1)
            _raise_to(rows, layer, -reach, axis=1)
        for shift in {dy, -dy}:
            _raise_to(found, rows, shift, axis=0)
    return found


def _raise_to(found: Array, values: Array, shift: int, axis: int) -> None:
    """Raise `found` to the values that stand so many rows (axis 0) or columns before it."""
    length = found.shape[axis]
    target = [slice(None), slice(None)]
    source = [slice(None), slice(None)]
    target[axis] = slice(max(shift, 0), length + min(shift, 0))
    source[axis] = slice(max(-shift, 0), length + min(-shift, 0))
    view = found[tuple(target)]
    np.maximum(view, values[tuple(source)], out=view)


def _close_gaps(rank: Array, distance: Array) -> None:
    """Give single empty pixels amid a surface the nearest of the points around them."""
    shown = rank >= 0
    neighbours = np.zeros((shown.shape[0] - 2, shown.shape[1] - 2), np.uint8)
    for dy, dx in _RING:
        neighbours += shown[1 + dy : shown.shape[0] - 1 + dy, 1 + dx : shown.shape[1] - 1 + dx]
    row, column = np.nonzero((neighbours >= _NEIGHBOURS) & ~shown[1:-1, 1:-1])
    around = np.stack([rank[1 + row + dy, 1 + column + dx] for dy, dx in _RING])
    away = np.append(distance, np.nan)[around]  # of -1, where nothing is drawn, the last
    surface = np.nanmax(away, axis=0) <= (1 + _GAP) * np.nanmin(away, axis=0) if row.size else row > 0
    rank[1 + row[surface], 1 + column[surface]] = around[:, surface].max(axis=0)


def shading(distance: Array) -> Array:
    """Return a factor (H, W) for the light of every pixel: edges stand out where the depth (H, W) steps back.

    Source: Boucheny, Visualisation scientifique de grands volumes de données, 2009 (eye-dome lighting).
    """
    depth = np.log(distance, where=np.isfinite(distance), out=np.full(distance.shape, np.inf, np.float32))
    around = np.pad(depth, 2, constant_values=np.inf)
    behind = np.zeros(distance.shape, np.float32)
    for down, right in _CROSS:
        neighbour = around[2 + down :, 2 + right :][: distance.shape[0], : distance.shape[1]]
        with np.errstate(invalid="ignore"):  # infinite minus infinite, where nothing is drawn
            step = depth - neighbour
        behind += np.where(np.isfinite(step), np.clip(step, 0, _DEEPEST), 0)
    factor: Array = np.maximum(np.exp(-_SHADE * behind / len(_CROSS)), _DARKEST)
    return factor


def picture(scene: CloudScene, paint: Paint, view: str, size: tuple[int, int], point_size: float = 1.0) -> Array:
    """Return a picture (H, W, 3), red, green, blue, uint8, of a view by its name or angle, with its labels.

    Raises InvalidInput for a view that is none, or a size that cannot be drawn.
    """
    seen = view_of(view, scene)
    return write_labels(rendered(scene, paint, seen, size, point_size), labels_of(scene, paint, seen, size, view))


def montage(
    scene: CloudScene, paint: Paint, size: tuple[int, int], point_size: float = 1.0, views: Sequence[str] = MONTAGE
) -> Array:
    """Return four views in one picture of a size: the camera's own, one from the side and above, top and side, or
    others by their names.
    """
    _require_size(size)
    whole = np.full((size[1], size[0], 3), 200, np.uint8)
    part = ((size[0] - _LINE) // 2, (size[1] - _LINE) // 2)
    for place, view in enumerate(views):
        row, column = (place // 2) * (part[1] + _LINE), (place % 2) * (part[0] + _LINE)
        whole[row : row + part[1], column : column + part[0]] = picture(scene, paint, view, part, point_size)
    return whole


def _require_size(size: tuple[int, int]) -> None:
    if not all(_LIMITS[0] <= side <= _LIMITS[1] for side in size):
        raise InvalidInput(f"a picture has sides of {_LIMITS[0]} to {_LIMITS[1]} pixels, not {size[0]}x{size[1]}")


def rendered(scene: CloudScene, paint: Paint, view: View, size: tuple[int, int], point_size: float) -> Array:
    """Return the points of a view (H, W, 3), red, green, blue, uint8, without labels.

    Raises InvalidInput for a size that cannot be drawn.
    """
    _require_size(size)
    drawn = draw(scene, view, size, point_size)
    pixels = np.empty((size[1], size[0], 3), np.uint8)
    pixels[:] = _BACKGROUND
    shown = drawn.index >= 0
    light = paint.colours[drawn.index[shown]] * shading(drawn.distance)[shown][:, None]
    pixels[shown] = np.rint(light).astype(np.uint8)
    return pixels


def labels_of(scene: CloudScene, paint: Paint, view: View, size: tuple[int, int], name: str) -> Labels:
    """Return what is to be written over a view."""
    caption = name if name in ("front", "top", "side") or (name == "camera" and scene.from_camera) else _angles(view)
    per_unit = view.focal(size) / view.distance if view.parallel else None
    return Labels(caption, scene.unit, per_unit, paint.scale, paint.name)


def _angles(view: View) -> str:
    azimuth, elevation = np.rint(np.degrees([view.azimuth, view.elevation])).astype(int).tolist()
    return f"azimuth {azimuth}°, elevation {elevation}°"


def video_frames(
    scene: CloudScene, paint: Paint, views: Sequence[View], size: tuple[int, int], point_size: float = 1.0
) -> Iterator[Array]:
    """Yield the pictures (H, W, 3) of some views, red, green, blue, uint8, with the legend of their colours."""
    for view in views:
        pixels = rendered(scene, paint, view, size, point_size)
        yield write_labels(pixels, labels_of(scene, paint, view, size, "camera")) if paint.scale else pixels


def write_video(path: Path, pictures: Iterator[Array]) -> None:
    """Write pictures of one size as a video, .gif (endless) or .mp4. Raises FileError if it cannot be written."""
    with replacing(path) as temporary:
        if path.suffix.lower() == ".gif":
            _write_gif(temporary, pictures)
        else:
            _write_mp4(temporary, pictures, path)


def _write_gif(path: Path, pictures: Iterator[Array]) -> None:
    """Write with the same 256 colours for all pictures, so that what stands still does not flicker."""
    videos = list(pictures)
    sample = Image.fromarray(np.vstack(videos[:: max(1, len(videos) // 6)]))
    palette = sample.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    first, *rest = (Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in videos)
    first.save(path, "GIF", save_all=True, append_images=rest, duration=1000 // _PER_SECOND, loop=0, optimize=False)


def _write_mp4(path: Path, pictures: Iterator[Array], named: Path) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    if height % 2 or width % 2:
        raise InvalidInput(f"an MP4 has sides of even numbers of pixels, not {width}x{height}", where=str(named))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*_CODEC), _PER_SECOND, (width, height))
    if not writer.isOpened():
        raise FileError("this OpenCV writes no MP4; write a .gif", where=str(named))
    count = 0
    for picture in chain([first], pictures):
        writer.write(np.ascontiguousarray(picture[:, :, ::-1]))
        count += 1
    writer.release()
    if cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) != count:  # OpenCV does not say so
        raise FileError("cannot be written as a whole; the disk may be full", where=str(named))


def nice_below(length: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, 50 … (or 0.5, 0.2, …) that is not above a positive length."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))


def write_labels(pixels: Array, labels: Labels) -> Array:
    """Return a picture (H, W, 3), red, green, blue, uint8, with its labels; elsewhere its pixels are untouched."""
    over = _overlay((pixels.shape[1], pixels.shape[0]), labels)
    share = over[..., 3:] / np.float32(255)
    mixed: Array = np.rint(pixels * (1 - share) + over[..., :3] * share).astype(np.uint8)
    return mixed


def _overlay(size: tuple[int, int], labels: Labels) -> Array:
    """Return the labels alone (H, W, 4), red, green, blue and opacity."""
    font = max(_SMALLEST_FONT, _FONT * min(size))
    with mpl.rc_context({"font.size": font * 72 / _DPI, "axes.linewidth": font / 16}):
        inches = ((size[0] + 0.5) / _DPI, (size[1] + 0.5) / _DPI)  # matplotlib cuts off what is no whole pixel
        figure = Figure(figsize=inches, dpi=_DPI)
        edge = (0.8 * font / size[0], 0.8 * font / size[1])
        figure.text(edge[0], 1 - edge[1], labels.caption, va="top", color=_INK, bbox=_PAPER)
        if labels.pixels_per_unit is not None:
            _draw_bar(figure, labels, size, font)
        if labels.scale is not None:
            _draw_legend(figure, labels, labels.scale, size, font)
        stream = BytesIO()
        figure.savefig(stream, format="rgba", dpi=_DPI, facecolor="none")
    return np.frombuffer(stream.getvalue(), np.uint8).reshape(size[1], size[0], 4)


def _draw_bar(figure: Figure, labels: Labels, size: tuple[int, int], font: float) -> None:
    """Draw a length and what it is, at the bottom left."""
    per_unit = labels.pixels_per_unit or 1.0
    length = nice_below(_BAR * size[0] / per_unit)
    width = length * per_unit / size[0]
    axes = figure.add_axes((font / size[0], font / size[1], width, 0.45 * font / size[1]))
    axes.set_facecolor(_INK)
    axes.set_xticks([])
    axes.set_yticks([])
    place = (1.1 * font / size[0], 1.9 * font / size[1])
    figure.text(*place, f"{length:g} {labels.unit}", va="bottom", color=_INK, bbox=_PAPER)


def _draw_legend(figure: Figure, labels: Labels, scale: ColourScale, size: tuple[int, int], font: float) -> None:
    """Draw the colours and the numbers they stand for, at the bottom right."""
    height, wide = min(0.42 * size[1], 14 * font), 5.6 * font
    left, bottom = size[0] - wide - 0.5 * font, 0.7 * font
    paper = figure.add_axes((left / size[0], bottom / size[1], wide / size[0], (height + 2.6 * font) / size[1]))
    paper.set_facecolor((1, 1, 1, _OPACITY))
    paper.set_xticks([])
    paper.set_yticks([])
    for side in paper.spines.values():
        side.set_visible(False)
    paper.text(0.5, 1 - 0.5 * font / (height + 2.6 * font), f"{labels.scale_name}, {labels.unit}", ha="center",
               va="top", color=_INK)  # fmt: skip
    bar = ((left + 0.7 * font) / size[0], (bottom + 0.6 * font) / size[1], 1.1 * font / size[0], height / size[1])
    axes = figure.add_axes(bar)
    norm = (LogNorm if scale.logarithmic else Normalize)(scale.low, scale.high)
    colours = mpl.cm.ScalarMappable(norm, ListedColormap(turbo_table() / 255))
    colour_bar = figure.colorbar(colours, cax=axes, ticks=_ticks(scale))
    colour_bar.ax.yaxis.set_minor_locator(NullLocator())
    colour_bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
    colour_bar.ax.tick_params(colors=_INK, width=font / 16, length=0.3 * font, pad=0.25 * font)


def _ticks(scale: ColourScale) -> list[float]:
    """Return numbers within a scale to write beside it: round ones, at most nine."""
    if not scale.logarithmic:
        inside = MaxNLocator(nbins=7, steps=[1, 2, 2.5, 5, 10]).tick_values(scale.low, scale.high)
        return [float(value) for value in inside if scale.low <= value <= scale.high]
    powers = 10.0 ** np.arange(np.floor(np.log10(scale.low)), np.ceil(np.log10(scale.high)) + 1)
    for steps in ((1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = [float(power * step) for power in powers for step in steps]
        inside = [value for value in ticks if scale.low <= value <= scale.high]
        if len(inside) <= 9:
            return inside
    return [scale.low, scale.high]
