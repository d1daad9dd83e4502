"""Views in images of other sizes: reported, or with --mixed-sizes mapped to the usual size.

A file does not tell which way an image was turned by 90 degrees, and turned the wrong way its lens is upside down: its
principal point lies on the other side of the middle. So the other views are calibrated, and the way that this lens fits
clearly better is taken. Where both fit alike, the image is left out.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from camcal.calibrate import intrinsics
from camcal.calibrate.fit import ShapeOptions
from camcal.calibrate.intrinsics import Calibration
from camcal.calibrate.view_records import names_of
from camcal.cameras.catalogue import DEFAULT_MODEL, WIDE_MODEL, model_named
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field
from camcal.errors import CamcalError
from camcal.messages import Message, counted
from camcal.targets.board import Board
from camcal.targets.detection import (
    CLOCKWISE,
    COUNTER_CLOCKWISE,
    TURNED,
    BoardDetection,
    PixelMap,
    Size,
    pixel_map,
    size_relation,
    size_words,
)

OPTION = "--mixed-sizes"
_MODELS = (DEFAULT_MODEL, WIDE_MODEL)  # of which the one with less noise tells how images were turned
_CLEARER = 1.5  # times: how much larger the median residual of the other way must be
_LIMIT = 5.0  # times the noise of the other views: the median residual of a view that fits
_NAMED = 4  # images in a message


@dataclass(frozen=True, eq=False)
class SameSize:
    """Views that are all of one size, or without points and with the reason.

    maps: for the images that were made to fit, by name. warnings: which images of other sizes are used or not.
    """

    views: tuple[BoardDetection, ...]
    maps: Mapping[str, PixelMap] = field(default_factory=dict)
    warnings: tuple[Message, ...] = ()

    def in_files(self, before: Sequence[BoardDetection]) -> tuple[BoardDetection, ...]:
        """Return the views with the pixels of their files; before: as they were before they were made to fit."""
        pairs = zip(before, self.views, strict=True)
        return tuple(old if old.image in self.maps else new for old, new in pairs)


def usual_size(views: Sequence[BoardDetection]) -> Size:
    """Return the size of most views with points, (width, height); (0, 0) if there are none."""
    sizes = Counter(view.size for view in views if view.found)
    return max(sizes, key=lambda size: sizes[size], default=(0, 0))


def circle_fits(circle: ImageCircle, views: Sequence[BoardDetection]) -> bool:
    """Return whether a circle is of images of the usual size, and holds all points that were found in these."""
    size = usual_size(views)
    inside = (circle.contains(view.pixels).all() for view in views if view.size == size)
    return circle.image_size == size and all(inside)


def same_size(views: Sequence[BoardDetection], usual: Size, board: Board, *, mixed: bool | None) -> SameSize:
    """Return the views with points in images of the usual size (width, height); of others their points are dropped.

    mixed: images of half or twice the size, turned by 90 degrees, or a pixel or two off are used all the same; None is
    no, by a command without that option.
    """
    others = [view for view in views if view.found and view.size != usual]
    maps, reasons = _maps(views, others, usual, board) if mixed else ({}, {})
    result = []
    for view in views:
        if not view.found or view.size == usual:
            result.append(view)
        elif view.image in maps:
            result.append(maps[view.image].apply(view))
        else:
            offered = mixed is False and size_relation(view.size, usual) is not None
            hint = f"; {OPTION} uses it" if offered else ""
            reason = reasons.get(view.image) or _differs(view, usual) + hint
            result.append(view.without_points(reason))
    return SameSize(tuple(result), maps, _size_warnings(others, maps, usual, mixed=mixed))


def _differs(view: BoardDetection, usual: Size) -> str:
    """Return in words that a view is of another size, and how the sizes are related if they are."""
    words = f"image {_words(view.size)} differs from the majority {_words(usual)}"
    related = size_relation(view.size, usual) is not None
    return f"{words}: {size_words(view.size, usual)}" if related else words


def _words(size: Size) -> str:
    return f"{size[0]}x{size[1]}"


def _size_warnings(
    others: Sequence[BoardDetection], maps: Mapping[str, PixelMap], usual: Size, *, mixed: bool | None
) -> tuple[Message, ...]:
    """Return a warning for every size related to the usual one: whether its images are used, and their names."""
    named: dict[tuple[bool, Size], list[str]] = defaultdict(list)
    for view in others:
        if size_relation(view.size, usual) is not None:
            named[view.image in maps, view.size].append(Path(view.image).name)
    found = []
    for (used, size), images in named.items():
        what = f"used with {OPTION}" if used else "not used"
        hint = f"; {OPTION} uses such images" if mixed is False else ""
        count = f"{counted(len(images), 'image')} of {_words(size)}"
        words = f"{size_words(size, usual)} (the majority: {_words(usual)})"
        text = f"{what}: {count}, {words}: {names_of(images, _NAMED)}{hint}"
        found.append(Message("mixed_image_sizes", text, {"images": len(images), "width": size[0], "height": size[1]}))
    return tuple(found)


def _maps(
    views: Sequence[BoardDetection], others: Sequence[BoardDetection], usual: Size, board: Board
) -> tuple[dict[str, PixelMap], dict[str, str]]:
    """Return the maps of images that can be used, and why other ones cannot although their sizes are related."""
    turned = [view for view in others if size_relation(view.size, usual) == TURNED]
    maps = {
        view.image: pixel_map(view.size, usual)
        for view in others
        if size_relation(view.size, usual) not in (None, TURNED)
    }
    if not turned:
        return maps, {}
    fitting = [view for view in views if view.found and view.size == usual]
    fitting += [maps[view.image].apply(view) for view in others if view.image in maps]
    lens, failure = _calibrated(fitting, board)
    reasons = {}
    for view in turned:
        found = failure if lens is None else _way(view, usual, lens)
        if isinstance(found, PixelMap):
            maps[view.image] = found
        else:
            reasons[view.image] = f"{_differs(view, usual)}; {found}"
    return maps, reasons


def _calibrated(views: Sequence[BoardDetection], board: Board) -> tuple[Calibration | None, str]:
    """Return the calibration of the usual views that leaves the least noise, or why there is none."""
    shape = ShapeOptions(smooth=True, offsets=False)
    found, failure = [], ""
    for name in _MODELS:
        try:
            found.append(intrinsics.calibrate(views, board, intrinsics.Options(model_named(name), shape=shape)))
        except CamcalError as error:
            failure = f"direction of rotation unknown without a calibration of the other images: {error.message}"
    return min(found, key=lambda calibration: calibration.sigma_px, default=None), failure


def _way(view: BoardDetection, usual: Size, lens: Calibration) -> PixelMap | str:
    """Return how a turned view becomes one of the usual size by the way that the lens fits, or why that is unclear."""
    from camcal.estimate.pnp import estimate_poses
    from camcal.estimate.poses.records import Correspondences, PoseOptions

    maps = [pixel_map(view.size, usual, quarter) for quarter in (CLOCKWISE, COUNTER_CLOCKWISE)]
    points = lens.surface.points()[view.ids]
    both = [each.apply(view) for each in maps]
    seen = [Correspondences(one.image, points, one.pixels, one.covariance) for one in both]
    outcomes = estimate_poses(lens.camera, seen, PoseOptions(intrinsics=False))
    medians = [
        np.inf if outcome.value is None else float(np.nanmedian(np.linalg.norm(outcome.value.residuals, axis=1)))
        for outcome in outcomes
    ]
    best, other = sorted(medians)
    limit = _LIMIT * lens.sigma_px
    if not best <= limit:
        return f"rejected in both rotations: median {best:.2f} px (limit {limit:.2f} px)"
    if other < _CLEARER * best:
        return f"ambiguous rotation: median {best:.2f} and {other:.2f} px"
    return maps[medians.index(best)]
