"""The pictures of a page: plots in both themes, and images of a calibration as thumbnails.

A thumbnail shows corners, magnified residuals, rejected corners, and the photograph. Plots are drawn as lines where
these are few, as pixels where they are many.
"""

import base64
import re
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Calibration, View
from camcal.dataclass import dataclass
from camcal.messages import counted
from camcal.report.figures.figure import DARK, LIGHT, Plot, Theme, encoded_in
from camcal.report.page.record import Picture, Thumbnail
from camcal.targets.detection import BoardDetection

_PX_PER_INCH = 96
_COLOUR = re.compile(rb"#[0-9a-f]{6}\b")
MOST = 12  # images shown; all are listed
PHOTO = re.compile(r"data:image/jpeg;base64,[A-Za-z0-9+/]+={0,2}")  # a photograph of a page
_WIDTH = 320  # px of a photograph
_QUALITY = 60
_REACH = 0.05  # of the image width: how long the longest usual residual is drawn
_QUANTILE = 0.95
_CROSS = 0.012  # of the image width
_FACTORS = tuple(digit * 10**power for power in range(6) for digit in (1, 2, 5))


def pictures(plots: Sequence[Plot], prefix: str = "") -> dict[str, Picture]:
    """Return the pictures of plots by the names of these; prefix: of their ids in the page."""
    return {plot.name: _picture(plot, prefix) for plot in plots}


def _picture(plot: Plot, prefix: str) -> Picture:
    suffix = ".png" if plot.dense else ".svg"
    light, *others = encoded_in(plot, suffix, (LIGHT, DARK) if plot.dense else (LIGHT,), titled=False)
    dark = others[0] if others else _recolour(light)  # of what is drawn as lines, the colours are in the text
    width, height = (round(side * _PX_PER_INCH) for side in plot.size)
    return Picture(
        f"{prefix}figure-{plot.name}",
        plot.title,
        plot.caption,
        plot.alt,
        light=data_uri(light, suffix),
        dark=data_uri(dark, suffix),
        size=(width, height),
    )


def _recolour(svg: bytes) -> bytes:
    """Return an SVG of the light theme in the colours of the dark one."""
    pairs = dict(zip(reversed(_colours(LIGHT)), reversed(_colours(DARK)), strict=True))
    return _COLOUR.sub(lambda found: pairs.get(found.group(), found.group()), svg)


def _colours(theme: Theme) -> list[bytes]:
    named = (theme.paper, theme.ink, theme.faint, *theme.series, theme.bad, theme.good)
    return [colour.encode("ascii") for colour in named]


def data_uri(content: bytes, suffix: str) -> str:
    """Return the bytes of an image file as a data URI."""
    kind = {".svg": "svg+xml", ".png": "png", ".jpg": "jpeg"}[suffix]
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"


@dataclass(frozen=True, eq=False)
class ViewResiduals:
    """The corners of a view: pixels (N, 2) and residuals (N, 2) of those that count, and of rejected ones (M, 2)."""

    view: View
    pixels: Array
    residuals: Array
    rejected: Array
    rejected_residuals: Array


def views_of(calibration: Calibration) -> list[ViewResiduals]:
    """Return the corners of all views of a calibration, in their order."""
    ends = np.cumsum([view.kept for view in calibration.views])
    result = []
    for view, end in zip(calibration.views, ends.tolist(), strict=True):
        part = slice(end - view.kept, end)
        lost = [corner for corner in calibration.rejected if corner.image == view.image]
        pixels = np.array([corner.pixel for corner in lost]).reshape(-1, 2)
        residuals = np.array([corner.residual for corner in lost]).reshape(-1, 2)
        result.append(ViewResiduals(view, calibration.pixels[part], calibration.residuals[part], pixels, residuals))
    return result


def worst_first(views: Sequence[ViewResiduals]) -> list[ViewResiduals]:
    """Return views in the order in which they deserve a look: rejected ones, by RMS, those without a board."""

    def key(each: ViewResiduals) -> tuple[bool, bool, float]:
        return not each.view.rejected, not each.view.used, -(each.view.rms_px or 0.0)

    return sorted(views, key=key)


def magnification(views: Sequence[ViewResiduals], width: int) -> int:
    """Return the round factor by which the residuals of all thumbnails are drawn longer."""
    lengths = np.concatenate([np.linalg.norm(each.residuals, axis=1) for each in views] or [np.zeros(0)])
    if not len(lengths):
        return 1
    longest = max(float(np.quantile(lengths, _QUANTILE)), 1e-9)
    return max((factor for factor in _FACTORS if factor * longest <= _REACH * width), default=1)


def thumbnails(
    calibration: Calibration, photos: Mapping[str, str], camera: str = "", most: int = MOST
) -> tuple[list[Thumbnail], int]:
    """Return the thumbnails of the worst views, and by how much their residuals are magnified.

    photos: photographs as data URIs by `photo_key`.
    """
    size = calibration.camera.image_size
    views = views_of(calibration)
    chosen, factor = worst_first(views)[:most], magnification(views, size[0])
    return [_thumbnail(each, size, factor, camera, photos) for each in chosen], factor


def photo_key(camera: str, image: str) -> str:
    """Return the key of a photograph of an image."""
    return f"{camera}/{image}" if camera else image


def corner_thumbnail(view: BoardDetection, photo: str) -> Thumbnail:
    """Return the thumbnail of a view without a calibration: its corners."""
    return Thumbnail(
        photo_key(view.camera, view.image),
        _name(view.image),
        counted(len(view.ids), "corner"),
        view.size,
        view.found,
        photo,
        dots=_dots(view.pixels),
    )


def _thumbnail(
    each: ViewResiduals, size: tuple[int, int], factor: int, camera: str, photos: Mapping[str, str]
) -> Thumbnail:
    view, key = each.view, photo_key(camera, each.view.image)
    radius = _CROSS * size[0]
    return Thumbnail(
        key,
        _name(view.image),
        _words(view, len(each.rejected)),
        size,
        view.used,
        photos.get(key, ""),
        dots=_dots(each.pixels),
        arrows=_arrows(each.pixels, each.residuals, factor)
        + _arrows(each.rejected, each.rejected_residuals, factor, 3 * radius),
        crosses="".join(_cross(x, y, radius) for x, y in each.rejected.tolist()),
    )


def _dots(pixels: Array) -> str:
    return "".join(f"M{x:.1f} {y:.1f}h0" for x, y in pixels.tolist())


def _arrows(pixels: Array, residuals: Array, factor: int, most: float = np.inf) -> str:
    """Return the lines of residuals as an SVG path; longer ones than `most` px of the image are cut."""
    drawn = factor * residuals
    lengths = np.linalg.norm(drawn, axis=1)
    known = np.isfinite(lengths)
    drawn = drawn[known] * np.minimum(1.0, most / np.maximum(lengths[known], 1e-9))[:, None]
    pairs = zip(pixels[known].tolist(), drawn.tolist(), strict=True)
    return "".join(f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}" for (x, y), (dx, dy) in pairs)


def _cross(x: float, y: float, r: float) -> str:
    return f"M{x - r:.1f} {y - r:.1f}l{2 * r:.1f} {2 * r:.1f}M{x - r:.1f} {y + r:.1f}l{2 * r:.1f} {-2 * r:.1f}"


def _name(image: str) -> str:
    return image.replace("\\", "/").rpartition("/")[2] or image


def _words(view: View, rejected: int) -> str:
    if view.reason is not None:
        return f"not used: {view.reason}"
    lost = f", {rejected} rejected" if rejected else ""
    return f"RMS {view.rms_px or 0.0:.3g} px, {counted(view.kept, 'corner')}{lost}"


def photograph(gray: Array) -> str:
    """Return an image (H, W) as a small JPEG, a data URI."""
    height, width = gray.shape
    scale = min(1.0, _WIDTH / width)
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    small = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    done, content = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data_uri(content.tobytes(), ".jpg") if done else ""
