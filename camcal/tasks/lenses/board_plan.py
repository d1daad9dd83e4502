"""Planning of a board for a camera: distances at which it fits, is sharp and detectable, and accuracy."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from math import inf, pi, sqrt

import numpy as np

from camcal import optics
from camcal.arrays import Array
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.forecast import calibration_std, forecast_pose
from camcal.records import entry
from camcal.simulate.scene import observe
from camcal.simulate.scene import views as scene_views
from camcal.targets.board import APRILGRID, ASYMMETRIC_CIRCLES, Board
from camcal.targets.board_types import TAG_BORDER
from camcal.targets.pattern import family_named
from camcal.tasks.lenses.optics_figures import AtDistance, at_distance
from camcal.tasks.lenses.optics_setup import Setup
from camcal.tasks.lenses.options import BoardOptions

_BORDER = 1.0  # squares around the corners that must be in the image
_HALVINGS = 24  # of a factor of 2 between distances: to 4e-8
_REACH = 1e4  # board sizes between which distances are searched for
_SQUARE_PX, _CELL_PX = 8.0, 2.0  # of a chessboard, and of a marker's cell

POSE = ("tx_mm", "ty_mm", "tz_mm", "rx_deg", "ry_deg", "rz_deg")
_TO_POSE = (1e3, 1e3, 1e3, 180 / pi, 180 / pi, 180 / pi)


@dataclass(frozen=True)
class BoardAt:
    """The board at one distance (m), its centre in the middle of the image.

    smallest_px, largest_px: sides of squares or tags, steps between circles. share: of the image's width or height,
    above 1 where it does not fit. square_for_share: side of a square or tag (or a step) of the same grid that takes the
    wanted share, m, None if none does. noise_px: of a corner, with blur. sigma: standard deviations of the pose of the
    board's centre, tx ty tz (m) rx ry rz (rad), p_wrong: how often another pose will fit better; None where the board
    does not fit the image.
    """

    distance: float = field(metadata=entry("distance_m", 1.0, "distance", "m"))
    smallest_px: float = field(metadata=entry("smallest_square_px", 1.0, "smallest {element}", "px"))
    largest_px: float = field(metadata=entry("largest_square_px", 1.0, "largest {element}", "px"))
    share: float = field(metadata=entry("share", 1.0, "share of the image", ""))
    square_for_share: float | None = field(
        metadata=entry("square_for_share_mm", 1e3, "{element} for the wanted share", "mm")
    )
    noise_px: float = field(metadata=entry("noise_px", 1.0, "noise of a corner", "px"))
    p_wrong: float | None = field(default=None, metadata=entry("p_wrong", 1.0, "probability of a wrong pose", ""))
    sigma: tuple[float, ...] | None = field(default=None, metadata=entry("pose_std", _TO_POSE, parts=POSE))


@dataclass(frozen=True, eq=False)
class BoardPlan:
    """A board, what it will be like at some distances, and the calibration from `views` views of it.

    nearest: where it just fits the image (0: anywhere), farthest: where its squares have as few pixels as allowed,
    least_px.
    calibration: standard deviations by parameter, None (and the reason) where no such views exist.
    """

    board: Board
    options: BoardOptions
    least_px: float
    nearest: float
    farthest: float
    at: tuple[BoardAt, ...]
    calibration: Mapping[str, float] | None
    reason: str | None


def plan_board(setup: Setup, wanted: Board, options: BoardOptions, distances: Sequence[float]) -> BoardPlan:
    """Return what to expect of a board before a camera, at some distances (m) or where it takes the wanted share.

    Raises InvalidInput for a board of unknown size, or a camera that is not known well enough.
    """
    camera, board = _camera(setup), _upright(wanted, setup)
    if board.square is None:
        raise InvalidInput("the board's size is unknown; add the side of a square, such as chessboard:9x6:25mm")
    held = _Held(camera, board, options.tilt)
    filling = held.at_share(options.share)
    least_px = _least_square(board) if options.least_px is None else options.least_px
    farthest = held.at_square(least_px)
    known = [at_distance(setup, distance) for distance in distances or [filling or farthest]]
    stds, reason = _calibration(setup, board, options)
    return BoardPlan(
        board=board,
        options=options,
        least_px=least_px,
        nearest=held.at_share(1.0),
        farthest=farthest,
        at=tuple(_at(held, setup, options, one, filling) for one in known),
        calibration=stds,
        reason=reason,
    )


def _camera(setup: Setup) -> Camera:
    if setup.camera is None:
        raise InvalidInput("--board needs a CAMERA file, or --focal, --size and --pitch-um (or --sensor)")
    return setup.camera


def _least_square(board: Board) -> float:
    """Return the pixels that a side of a square must have for the board to be found.

    On simulated photographs squares of a chessboard are found down to 6 px, circles from 7 px of distance on, markers
    and tags down to 1.7 px a cell.
    """
    if board.marker is None or board.dictionary is None:
        return _SQUARE_PX
    bits = family_named(board.dictionary).bits
    if board.type == APRILGRID:
        return _CELL_PX * (bits + 2 * TAG_BORDER)
    return _CELL_PX * (bits + 2) * board.spacing / board.marker


def _upright(board: Board, setup: Setup) -> Board:
    """Return the board with its long side along that of the image; an asymmetric grid would be another one turned."""
    if board.type == ASYMMETRIC_CIRCLES:
        return board
    width, height = setup.size or (1, 1)
    return board.transposed() if (board.columns > board.rows) != (width >= height) else board


def _element(board: Board) -> float:
    """Return the side of a square or tag, or the step from circle to circle, m."""
    return board.marker or board.spacing if board.type == APRILGRID else board.spacing


def _sides(board: Board, pixels: Array) -> Array:
    """Return the lengths (K,) in pixels of the sides of squares or tags, or of the pitch of circles, as projected."""
    if board.type == APRILGRID:
        tags = pixels.reshape(-1, 4, 2)
        return np.asarray(np.linalg.norm(tags - np.roll(tags, 1, axis=1), axis=2).ravel())
    grid = pixels.reshape(board.rows, board.columns, 2)
    along, down = grid[:, 1:] - grid[:, :-1], grid[1:] - grid[:-1]
    if board.type == ASYMMETRIC_CIRCLES:  # two pitches apart in a row and from row to next but one
        along, down = along / 2, (grid[2:] - grid[:-2]) / 2
    return np.concatenate([np.linalg.norm(steps, axis=2).ravel() for steps in (along, down)])


@dataclass(frozen=True, eq=False)
class _Held:
    """A board of known size before a camera, tilted about the vertical by `tilt` (rad)."""

    camera: Camera
    board: Board
    tilt: float

    @property
    def points(self) -> Array:
        """The corners (C, 3) from the board's centre, m."""
        return self.board.points() - np.array([*self.board.extent, 0.0]) / 2

    @cached_property
    def _middle(self) -> Array:
        """The ray (3,) of the middle of the image, of depth 1."""
        pixel = (np.array([self.camera.image_size], dtype=float) - 1) / 2
        ray = self.camera.unproject(pixel).directions[0]
        return np.asarray(ray / ray[2])

    def pose(self, distance: float) -> Pose:
        """Return camera_T_board with the board's centre in the middle of the image, at a distance along the axis."""
        upright = np.diag([1.0, self.board.z_sign, self.board.z_sign])
        return Pose(so3.about_y(self.tilt) @ upright, distance * self._middle)

    def share(self, distance: float) -> float:
        """Return the share of the image's width or height that the board takes, inf outside the lens's domain."""
        reach = np.array(self.board.extent) / 2 + _BORDER * self.board.spacing
        corners = np.array([[x, y, 0.0] for x in np.linspace(-1, 1, 9) for y in (-1, 0, 1)]) * [*reach, 0.0]
        projection = self.camera.project(self.pose(distance).apply(corners))
        if not projection.valid.all():
            return inf
        middle = (np.array(self.camera.image_size) - 1) / 2
        return float(np.max(2 * np.abs(projection.pixels - middle).max(axis=0) / self.camera.image_size))

    def squares(self, distance: float) -> tuple[float, float]:
        """Return the smallest and the largest side of a square or tag in pixels, inf outside the lens's domain."""
        projection = self.camera.project(self.pose(distance).apply(self.points))
        if not projection.valid.all():
            return inf, inf
        sides = _sides(self.board, projection.pixels)
        return float(sides.min()), float(sides.max())

    def at_share(self, share: float) -> float:
        """Return the distance (m) at which the board takes a share of the image, 0 if it never takes so much."""
        return self._farthest(lambda distance: self.share(distance) > share)

    def at_square(self, least_px: float) -> float:
        """Return the farthest distance (m) at which the smallest square has so many pixels, 0 if it never has."""
        return self._farthest(lambda distance: self.squares(distance)[0] > least_px)

    def _farthest(self, is_near: Callable[[float], bool]) -> float:
        """Return up to which distance (m) a board is near, 0 if it is nowhere.

        Searched for from afar: close to a wide lens the outer squares shrink again.
        """
        nearest, high = (max(self.board.extent) * reach for reach in (1 / _REACH, _REACH))
        low = high
        while not is_near(low):
            if low < nearest:
                return 0.0
            low, high = low / 2, low
        for _ in range(_HALVINGS):
            middle = sqrt(low * high)
            low, high = (middle, high) if is_near(middle) else (low, middle)
        return high


def _at(held: _Held, setup: Setup, options: BoardOptions, known: AtDistance, filling: float) -> BoardAt:
    distance = known.distance
    smallest, largest = held.squares(distance)
    noise = options.noise_px * _blur_factor(setup, known)
    share = held.share(distance)
    square = _element(held.board) * distance / filling if filling else None
    if share > 1:
        return BoardAt(distance, smallest, largest, share, square, noise)
    covariance, p_wrong = forecast_pose(held.camera, held.points, held.pose(distance), noise)
    sigma = tuple(np.sqrt(np.diag(covariance)).tolist())
    return BoardAt(
        distance=distance,
        smallest_px=smallest,
        largest_px=largest,
        share=share,
        square_for_share=square,
        noise_px=noise,
        sigma=sigma,
        p_wrong=p_wrong,
    )


def _blur_factor(setup: Setup, known: AtDistance) -> float:
    """Return how much more a corner scatters than in a sharp image at rest: by defocus and motion, where known."""
    number, pitch = setup.effective_f_number, setup.pitch
    spot = 0.0 if number is None or pitch is None else optics.airy_sigma(setup.options.wavelength, number) / pitch
    spread = optics.edge_spread(spot, known.blur_px or 0.0, known.motion_px or 0.0)
    return optics.edge_noise_factor(spread, optics.edge_spread(spot, 0.0, 0.0))


def _calibration(setup: Setup, board: Board, options: BoardOptions) -> tuple[Mapping[str, float] | None, str | None]:
    camera = _camera(setup)
    if not setup.measured:
        model = model_named(DEFAULT_MODEL)  # which it will be calibrated with
        camera = Camera(model, camera.image_size, model.start(camera.image_size, camera.value("fx")))
    rng = np.random.default_rng(0)
    try:
        poses = scene_views(replace(camera, covariance=None), board, options.views, rng=rng)
        detections, _ = observe(camera, board, poses, rng=rng)
        std = calibration_std(camera, board, detections.views, poses, options.noise_px)
    except (InvalidInput, InsufficientData) as error:
        return None, str(error)
    return dict(zip(camera.model.parameter_names, std.tolist(), strict=True)), None
