"""The verdict of a check: a calibration still holds, something has drifted, or new views cannot tell."""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import degrees, pi

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import ROLLING
from camcal.calibrate.known_cameras import KnownBoard, KnownCamera, NewViews, examine
from camcal.cameras.directions import grid_pixels
from camcal.cameras.model import Camera, resized
from camcal.cameras.observations import Observations
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry.pose import Pose
from camcal.messages import counted
from camcal.quality.camera_comparison import MOST_SHIFT, MOST_ZOOM
from camcal.quality.camera_drift import (
    Drift,
    Estimated,
    LensDrift,
    PlaceDrift,
    drift_grid,
    focal_axis,
    lens_drift,
    place_drift,
)
from camcal.quality.forecast import free_parameters
from camcal.quality.mount import MountMovement, mount_movement
from camcal.quality.projection_uncertainty import in_polygon
from camcal.quality.view_advice import Known, SuggestedView, telling_view
from camcal.solve.losses import variance_ratio_beyond
from camcal.solve.steps import SingularError
from camcal.targets.detection import BoardDetection

VALID, DRIFTED, NOT_SHOWN = "valid", "drifted", "not_shown"
WORDS = {DRIFTED: "drifted", NOT_SHOWN: "not shown", VALID: "still valid"}  # the worst first
LENS, PLACE, BOARD, IMAGE, OTHER = "lens", "mount", "board", "image", "another camera"
_LEAST = 4  # points of a view that has a pose
_NOISY, _FOREIGN = 3.0, 8.0  # times the noise of the calibration: worth a note; not of this camera, from _FOREIGN_PX on
_FOREIGN_PX = 1.0
_SPOILT = 0.3  # of the corners: so many that do not fit are worth a note
_CHANCE = 1e-4  # of a board's shape to differ so much from the known one
_ROLLS = 3.0  # times the noise: what the exposure of rows one after the other moves a corner by, worth a note


@dataclass(frozen=True, eq=False)
class Checked:
    """What a check has found of one camera, or of where one stands.

    verdict: one of WORDS. cause: of a drift. reason: the verdict's, in words. notes: on the images. limit_px: the drift
    that counts. movement: of a camera against something that has not moved. next_view: that would show most, where
    a drift was not shown. views: the images that show the board.
    """

    verdict: str
    reason: str
    cause: str = ""
    views: int = 0
    drift: Drift | None = None
    limit_px: float | None = None
    movement: MountMovement | None = None
    next_view: SuggestedView | None = None
    notes: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The verdict in words."""
        return f"{WORDS[self.verdict]}: {self.reason}"


@dataclass(frozen=True, eq=False)
class CheckedCamera:
    """A camera as its calibration knows it.

    region: (M, 2) px, where the calibration holds, empty for everywhere. views: of the calibration.
    """

    camera: Camera
    sigma_px: float
    region: Array
    views: float

    def known(self, views: Sequence[BoardDetection], captures: Array | None = None) -> KnownCamera:
        """Return it with new views."""
        own = np.arange(len(views)) if captures is None else captures
        return KnownCamera(self.camera, self.sigma_px, Observations.of(views), own)


def check_lens(
    own: CheckedCamera, views: Sequence[BoardDetection], board: KnownBoard, most_px: float | None = None
) -> Checked:
    """Return whether the calibration of a lens still holds, by views of a board.

    most_px: the drift that counts, see `Drift.limit`.
    """
    showing = usable(views)
    if not showing:
        return Checked(NOT_SHOWN, f"none of {counted(len(views), 'image')} shows {_LEAST} corners of the board")
    size = Counter(view.size for view in showing).most_common(1)[0][0]
    of_size = [view for view in showing if view.size == size]
    others = len(showing) - len(of_size)
    try:
        if size == own.camera.image_size:
            result = _check_lens(own, of_size, board, most_px)
        else:
            result = _check_size(own, of_size, board, size, most_px)
    except InsufficientData as error:
        result = Checked(NOT_SHOWN, error.message)
    notes = (f"{counted(others, 'image')} of another size left out",) if others else ()
    return replace(result, views=len(of_size), notes=notes + result.notes)


def _check_lens(
    own: CheckedCamera, views: Sequence[BoardDetection], board: KnownBoard, most_px: float | None
) -> Checked:
    """Return the verdict on views of the size that the calibration is for."""
    known = own.known(views)
    found = examine([known], [Pose.identity()], board)
    if found is None:
        return Checked(DRIFTED, "corners lie where this lens images nothing", OTHER)
    drift, sigma = lens_drift(known, found, _inside(own), own.views), found.sigma_px[0]
    result = Checked(DRIFTED, "", drift=drift, limit_px=drift.limit(most_px), notes=tuple(_notes(own, found, board)))
    if sigma > max(_FOREIGN * own.sigma_px, _FOREIGN_PX):
        reason = f"corners are {sigma:.2g} px from where this camera images the board: noise {own.sigma_px:.2g} px then"
        return replace(result, reason=reason, cause=OTHER)
    if not drift.beyond(most_px):
        return _with_next_view(_unmoved(result, drift), own, board, found.information)
    for words, turned in _turned(views, board):
        if _fits(own, turned, board, most_px):
            return replace(result, reason=f"the images are {words}: without that it still holds", cause=IMAGE)
    reason, cause = _lens_words(own, drift)
    return replace(result, reason=reason, cause=cause)


def check_place(
    pair: tuple[CheckedCamera, CheckedCamera],
    rows: Sequence[tuple[BoardDetection, BoardDetection]],
    pose: Pose,
    covariance: Array,
    board: KnownBoard,
    most_px: float | None = None,
) -> Checked:
    """Return whether the second of two cameras, whose lenses still hold, stands where it did.

    rows: their views of the same captures. pose: second_T_first. covariance: (N, N) of all parameters of the first
    lens, of the second one, and of the step of the pose.
    """
    captures = np.arange(len(rows))
    known = [own.known([row[place] for row in rows], captures) for place, own in enumerate(pair)]
    count = [len(own.camera.parameters) for own in pair]
    free = np.concatenate([known[0].free, count[0] + known[1].free, sum(count) + np.arange(6)])
    try:
        found = examine(known, [Pose.identity(), pose], board)
    except InsufficientData as error:
        return Checked(NOT_SHOWN, error.message, views=len(rows))
    if found is None:
        return Checked(DRIFTED, "corners lie where a lens images nothing", OTHER, len(rows))
    views = min(own.views for own in pair)
    drift = place_drift(found, covariance[np.ix_(free, free)], pose, views)
    result = Checked(DRIFTED, "", views=len(rows), drift=drift, limit_px=drift.limit(most_px))
    if not drift.beyond(most_px):
        return _unmoved(result, drift)
    reason, cause = _place_words(drift)
    return replace(result, reason=reason, cause=cause)


def check_mount(
    before: Sequence[tuple[Pose, Array]], now: Sequence[tuple[Pose, Array]], most_shift: float, most_turn: float
) -> Checked:
    """Return whether a camera stands where it did, by poses camera_T_object (m) with their covariances.

    most_shift, most_turn: m and rad, that count.
    """
    found = mount_movement(before, now)
    shift, turn = found.shift, found.turn
    words = (
        f"shifted by {_value(shift.scaled(1e3))} mm, turned by {_value(turn.scaled(180 / pi))}° (limits "
        f"{1e3 * most_shift:.3g} mm, {degrees(most_turn):.3g}°)"
    )
    result = Checked(VALID, words, views=len(now), movement=found)
    if found.moved(most_shift, most_turn):
        return replace(result, verdict=DRIFTED, cause=PLACE, reason=f"{words}: {found.way_back} to undo it")
    if found.shown(most_shift, most_turn):
        return result
    return replace(result, verdict=NOT_SHOWN, reason=f"{words}: add images, a larger board or a nearer one")


def usable(views: Sequence[BoardDetection]) -> list[BoardDetection]:
    """Return the views that have a pose."""
    return [view for view in views if len(view.ids) >= _LEAST]


def _unmoved(result: Checked, drift: Drift) -> Checked:
    """Return the result with the verdict on a drift that does not count."""
    limit = result.limit_px or 0.0
    if drift.smallest_px > limit:
        reason = (
            f"these images would show a drift of {drift.smallest_px:.2g} px or more (limit {limit:.2g} px): add "
            "images, or raise --max-drift"
        )
        return replace(result, verdict=NOT_SHOWN, reason=reason)
    reason = f"moved by {_value(drift.rms_px)} px RMS (limit {limit:.2g} px)"
    return replace(result, verdict=VALID, reason=f"{reason}; {drift.smallest_px:.2g} px would have shown")


def _with_next_view(result: Checked, own: CheckedCamera, board: KnownBoard, information: Array) -> Checked:
    """Return a result with the view that would show most of a change of the focal length, where that was not shown."""
    free = free_parameters(own.camera)
    if result.verdict != NOT_SHOWN or own.sigma_px == 0 or len(free) != len(information):
        return result
    known = Known(own.camera, board.surface, own.sigma_px)
    with suppress(InsufficientData, SingularError):  # no view of the whole board fits the image
        view = telling_view(known, information, focal_axis(own.camera)[free])
        return replace(result, next_view=view)
    return result


def _inside(own: CheckedCamera) -> Array | None:
    return in_polygon(grid_pixels(*drift_grid(own.camera.image_size)), own.region) if len(own.region) else None


def _notes(own: CheckedCamera, found: NewViews, board: KnownBoard) -> list[str]:
    """Return what is to be known of the images of one camera."""
    notes, sigma = [], found.sigma_px[0]
    if sigma > _NOISY * own.sigma_px > 0:
        notes.append(
            f"corners are {sigma / own.sigma_px:.1f} times as noisy as those of the calibration ({sigma:.2g} px): "
            "blur, motion, or another board"
        )
    if (rolling := found.effects[0][ROLLING.name]) > _ROLLS * sigma:
        notes.append(f"the camera or the board moved during the exposure: rows are shifted by {rolling:.2g} px RMS")
    if found.rejected[0] > _SPOILT:
        notes.append(f"{100 * found.rejected[0]:.0f} % of the corners do not fit and are not used")
    square, count = found.board
    if count and variance_ratio_beyond(square, count, max(board.views - 1, 1)) < _CHANCE:
        notes.append(f"the board is no longer of the shape that the calibration found ({square**0.5:.1f} sigma)")
    return notes


def _lens_words(own: CheckedCamera, drift: LensDrift) -> tuple[str, str]:
    """Return how a lens has drifted in words, and the cause."""
    shift = float(np.hypot(drift.shift[0].value, drift.shift[1].value))
    far = abs(drift.focal.value) > MOST_ZOOM or shift > MOST_SHIFT * np.hypot(*own.camera.image_size)
    focal = drift.focal.scaled(100)
    words = (
        f"{'another camera, or a lens set otherwise' if far else 'the lens moved'}: projections by "
        f"{_value(drift.rms_px)} px RMS, {_value(drift.worst_px)} px at most; focal length "
        f"{_value(focal, sign=True)} %, principal point ({', '.join(_value(each, sign=True) for each in drift.shift)}) "
        f"px, distortion {drift.distortion_px:.2g} px RMS"
    )
    return words, OTHER if far else LENS


def _place_words(drift: PlaceDrift) -> tuple[str, str]:
    """Return how a camera has moved in words, and the cause."""
    moved = f"the cameras moved against each other, by {_value(drift.rms_px)} px RMS: "
    if drift.scale is not None:
        percent = drift.scale.scaled(100)
        return (
            f"{moved}they are {_value(percent, sign=True)} % further apart, or the squares of the board are not as "
            "long as stated"
        ), BOARD
    shift, turn = 1e3 * drift.shift, np.degrees(drift.turn)
    return (
        f"{moved}shifted by {np.linalg.norm(shift):.2g} ± {1e3 * _along(drift.shift, drift.shift_std):.1g} mm "
        f"({', '.join(f'{each:+.2g}' for each in shift)}), turned by {np.linalg.norm(turn):.2g} ± "
        f"{degrees(_along(drift.turn, drift.turn_std)):.1g}° ({', '.join(f'{each:+.2g}' for each in turn)})"
    ), PLACE


def _along(values: Array, stds: Array) -> float:
    """Return the standard deviation of the length of values (3,)."""
    return float(np.sqrt(np.sum((values * stds) ** 2) / max(float(np.sum(values**2)), 1e-300)))


def _value(found: Estimated, *, sign: bool = False) -> str:
    """Return a value with its standard deviation, as many digits as that has two of."""
    digits = max(0, 1 - int(np.floor(np.log10(found.std)))) if 0 < found.std < 10 else 0
    digits = min(digits, 4)
    return f"{found.value:{'+' if sign else ''}.{digits}f} ± {found.std:.{digits}f}"


def _fits(own: CheckedCamera, views: Sequence[BoardDetection], board: KnownBoard, most_px: float | None) -> bool:
    """Return whether a camera explains views without a drift, and about as well as those of its calibration."""
    try:
        found = examine([own.known(views)], [Pose.identity()], board)
    except InsufficientData:
        return False
    if found is None or found.sigma_px[0] > max(_FOREIGN * own.sigma_px, _FOREIGN_PX):
        return False
    return not lens_drift(own.known(views), found, _inside(own), own.views).beyond(most_px)


def _check_size(
    own: CheckedCamera, views: Sequence[BoardDetection], board: KnownBoard, size: tuple[int, int], most_px: float | None
) -> Checked:
    """Return the verdict on views of another size than the camera's: how they have come about, if that shows."""
    width, height = own.camera.image_size
    sizes = f"the images are {size[0]}x{size[1]}, the calibration is for {width}x{height}"
    for words, other in _of_size(own, size):
        if _fits(other, views, board, most_px):
            return Checked(DRIFTED, f"{sizes}: {words} it still holds", IMAGE, len(views))
    return Checked(
        DRIFTED, f"{sizes}, and neither a change of resolution nor a central crop explains it", OTHER, len(views)
    )


def _of_size(own: CheckedCamera, size: tuple[int, int]) -> Iterator[tuple[str, CheckedCamera]]:
    """Yield a camera for images of another size with how they come from those of the calibration."""
    camera = own.camera
    width, height = camera.image_size
    scales = {1.0: "", **{share: f"scaled by {share:.4g} " for share in (size[0] / width, size[1] / height, 0.5, 0.25)}}
    for scale, words in scales.items():
        full = round(scale * width), round(scale * height)
        if full[0] < size[0] or full[1] < size[1]:
            continue
        try:
            whole = resized(camera, full) if full != camera.image_size else camera
        except InvalidInput:
            continue
        left = (full[0] - size[0]) / 2, (full[1] - size[1]) / 2
        parameters, ratio = whole.parameters.copy(), np.array(full) / camera.image_size
        parameters[2:4] -= left
        cropped = f"cropped in the middle from {full[0]}x{full[1]} " if any(left) else ""
        region = (own.region + 0.5) * ratio - 0.5 - left if len(own.region) else own.region
        made = replace(whole, image_size=size, parameters=parameters)
        yield (
            f"with its lens {words}{'and ' if words and cropped else ''}{cropped}".rstrip(),
            replace(own, camera=made, region=region),
        )


def _turned(views: Sequence[BoardDetection], board: KnownBoard) -> Iterator[tuple[str, list[BoardDetection]]]:
    """Yield the views as they would be if their images had not been turned or mirrored, in words what they are."""
    corner = np.array(views[0].size) - 1
    yield "upside down", [replace(view, pixels=corner - view.pixels) for view in views]
    drawn = board.surface.board
    if drawn.has_ids or not drawn.has_grid:
        return  # the codes of mirrored ones are not read
    across = np.arange(drawn.count).reshape(drawn.rows, drawn.columns)[:, ::-1].ravel()
    signs, shift = np.array([-1.0, 1.0]), np.array([corner[0], 0.0])
    yield (
        "mirrored",
        [
            replace(
                view,
                ids=across[view.ids],
                pixels=signs * view.pixels + shift,
                covariance=None if view.covariance is None else view.covariance * np.outer(signs, signs),
            )
            for view in views
        ],
    )
