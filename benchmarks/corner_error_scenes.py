"""Simulated corners of a board with known truth, among them errors that adjacent corners of a view share.

It does not use camcal.simulate, so that a mistake there does not cancel in a comparison; only the projection and the
exponential of a rotation are camcal's.
The poses are those of a board held by hand: its centre anywhere in the image, the distance within a factor of 2, tilts
up to 45° about both axes, any rotation in the image plane. Two views of five may be partial. Corners nearer than 8 px
to the image border are left out. The noise of a corner has a standard deviation of about 0.08 px, and the covariance
that comes with the corner states it, unless the scenario says otherwise. The same seed has the same poses and the same
noise in every scenario.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

NOISE = 0.08  # px, the typical standard deviation of a coordinate
SPREAD = 2.0  # the variance of a corner differs from the typical one by at most this factor
MARGIN = 8.0  # px
TILT = np.radians(45)
STEEPEST = np.radians(75)  # between the normal of the board and the line of sight to a corner
PARTIAL_SHARE = 0.5  # of the corners that a partial view has at least
ATTEMPTS, SHRINK = 15, 0.93  # the board is moved away by this factor after so many attempts

_POSE, _BOARD, _STD, _NOISE, _EFFECT, _OUTLIER = range(6)  # one random generator for each purpose


@dataclass(frozen=True)
class Setting:
    """A camera and the range of the image height that the longer side of the board takes, seen from the front."""

    camera: Camera
    fill: tuple[float, float]


CAMERAS = {
    "opencv5-1600x1200": Setting(
        Camera(
            model_named("opencv5"),
            (1600, 1200),
            np.array([1200.0, 1203.0, 809.0, 592.0, -0.20, 0.05, 5e-4, -3e-4, -0.01]),
        ),
        (0.4, 0.8),
    ),
    "opencv5-640x480": Setting(
        Camera(
            model_named("opencv5"),
            (640, 480),
            np.array([520.0, 519.0, 314.0, 245.0, -0.26, 0.10, -4e-4, 6e-4, -0.01]),
        ),
        (0.4, 0.8),
    ),
    "kannala_brandt4-1280x960": Setting(
        Camera(
            model_named("kannala_brandt4"),
            (1280, 960),
            np.array([420.0, 421.0, 645.0, 474.0, -0.02, 0.005, -0.002, 0.0003]),
        ),
        (0.25, 0.5),
    ),
}
BOARDS = (
    Board("chessboard", 14, 10, 0.030),
    Board("chessboard", 9, 6, 0.025),
    Board("chessboard", 8, 6, 0.040),
)


@dataclass(frozen=True, eq=False)
class Shot:
    """One view before noise: points (C, 3) of the board as it is, camera_T_board, the view's place 0…1 in the set."""

    camera: Camera
    board: Board
    points: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    place: float
    index: int
    rng: np.random.Generator

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels (C, 2) of points (C, 3) in the board frame; NaN where the lens has no image of them."""
        return self.camera.project(points @ self.rotation.T + self.translation).pixels


@dataclass(frozen=True, eq=False)
class Known:
    """What the oracle is given: the board (C, 3), the poses to start from, and corners without outliers.

    covariances: (2n, 2n) of each view's coordinates in the order u0 v0 u1 v1 …
    """

    points: np.ndarray
    rotations: np.ndarray
    translations: np.ndarray
    ids: tuple[np.ndarray, ...]
    pixels: tuple[np.ndarray, ...]
    covariances: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Scene:
    """What a calibration is given, and the true camera. known: None where the scenario has no oracle."""

    truth: Camera
    board: Board
    views: tuple[BoardDetection, ...]
    known: Known | None


# the board as it is


def as_drawn(board: Board, _: np.random.Generator) -> np.ndarray:
    return board.points()


def corner_print_errors(board: Board, rng: np.random.Generator, share: float) -> np.ndarray:
    """Return a board with independent errors of all corners in its plane, in shares of a square."""
    points = board.points()
    points[:, :2] += rng.normal(0, share * board.spacing, (board.count, 2))
    return points


def keystone(board: Board, rng: np.random.Generator, share: float) -> np.ndarray:
    """Return a board with a projective distortion in its plane, by a share of the longer side at that side's ends."""
    points, centre, half = board.points(), np.array(board.extent) / 2, max(board.extent) / 2
    angle = rng.uniform(0, 2 * np.pi)
    centred = points[:, :2] - centre
    scale = 1 - 2 * share * (centred / half) @ np.array([np.cos(angle), np.sin(angle)])
    points[:, :2] = centre + centred / scale[:, None]
    return points


def stretch(board: Board, _: np.random.Generator, ratio: float) -> np.ndarray:
    """Return a board that is longer along x by a ratio."""
    return board.points() * [1 + ratio, 1, 1]


def bent(board: Board, _: np.random.Generator, bow: tuple[float, float], twist: float = 0.0) -> np.ndarray:
    """Return a board with heights of the middle over the sides, along x and y, and of the corners, in metres."""
    points = board.points()
    x, y = _normalised(board)
    points[:, 2] = bow[0] * (1 - x**2) + bow[1] * (1 - y**2) + twist * x * y
    return points


def _normalised(board: Board) -> np.ndarray:
    """Return x and y (2, C) from -1 to 1 over the points."""
    half = np.array(board.extent) / 2
    return ((board.points()[:, :2] - half) / half).T


# how the corners of a view are imaged


def still(shot: Shot) -> np.ndarray:
    return shot.project(shot.points)


def rolling_shutter(shot: Shot, shear: float) -> np.ndarray:
    """Return pixels read row by row while the board moves at constant velocity and angular velocity.

    shear: the RMS distance in px, over corners and views, by which a corner moves while the whole image is read. The
    six components of the motion, the rotation being about the middle of the board, have equal shares of it.
    """
    centred = shot.points - shot.points.mean(axis=0)
    pivot = shot.rotation @ shot.points.mean(axis=0) + shot.translation
    step = 1e-4 * np.linalg.norm(pivot)

    def moved(motion: np.ndarray) -> np.ndarray:  # motions (6,) or (C, 6)
        turned = np.einsum("...ij,...j->...i", so3.exp(motion[..., 3:]), centred @ shot.rotation.T)
        return shot.camera.project(turned + pivot + motion[..., :3]).pixels

    units = np.repeat([step, 1e-4], 3)
    effects = [np.sqrt(np.nanmean(((moved(unit) - moved(-unit)) ** 2).sum(axis=1)) / 4) for unit in np.diag(units)]
    velocity = shot.rng.normal(size=6) * units / np.array(effects) * shear / np.sqrt(6)
    pixels = moved(np.zeros(6))
    for _ in range(8):
        time = pixels[:, 1] / shot.camera.image_size[1] - 0.5
        pixels = moved(np.nan_to_num(time)[:, None] * velocity)
    return pixels


def flexing(shot: Shot, share: float) -> np.ndarray:
    """Return pixels of a board with another bow and twist in each view, of this RMS in shares of the longer side."""
    x, y = _normalised(shot.board)
    modes = np.column_stack([x**2, x * y, y**2])
    plane = np.column_stack([np.ones_like(x), x, y])
    modes -= plane @ np.linalg.lstsq(plane, modes, rcond=None)[0]
    modes /= np.sqrt((modes**2).mean(axis=0))
    height = modes @ shot.rng.normal(0, share * max(shot.board.extent) / np.sqrt(3), 3)
    return shot.project(shot.points + height[:, None] * [0, 0, 1])


def zoom_drift(shot: Shot, ratio: float) -> np.ndarray:
    """Return pixels by a focal length that changes linearly by a ratio from the first view to the last."""
    parameters = shot.camera.parameters.copy()
    parameters[:2] *= 1 + ratio * (shot.place - 0.5)
    return replace(shot, camera=replace(shot.camera, parameters=parameters)).project(shot.points)


# errors of the corners in the image: (C, 2) px, and their covariance (2C, 2C)


def independent(_: Shot, noise: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return noise * std[:, None], np.diag(np.repeat(std**2, 2))


def correlated(shot: Shot, noise: np.ndarray, std: np.ndarray, rms: float) -> tuple[np.ndarray, np.ndarray]:
    """Return noise and a smooth field in u and v, of this RMS in px and the correlation exp(-distance / 4 squares)."""
    places = shot.board.points()[:, :2] / shot.board.spacing
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    covariance = rms**2 * np.exp(-distance / 4)
    field = np.linalg.cholesky(covariance) @ shot.rng.normal(size=(len(std), 2))
    errors, own = independent(shot, noise, std)
    return errors + field, own + np.kron(covariance, np.eye(2))


def blurred(shot: Shot, noise: np.ndarray, std: np.ndarray, factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Return noise that is larger by a factor along one direction in every third view."""
    if shot.index % 3:
        return independent(shot, noise, std)
    angle = shot.rng.uniform(0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    root = np.eye(2) + (factor - 1) * np.outer(along, along)
    return noise @ root * std[:, None], np.kron(np.diag(std**2), root @ root)


@dataclass(frozen=True)
class Scenario:
    """What is wrong with the corners.

    outliers: the share of corners that are off by OUTLIER px. claimed: the standard deviation that the corners come
    with over the true one of the independent noise.
    """

    board: Callable[[Board, np.random.Generator], np.ndarray] = as_drawn
    image: Callable[[Shot], np.ndarray] = still
    errors: Callable[[Shot, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]] = independent
    outliers: float = 0.0
    claimed: float = 1.0

    @property
    def oracle(self) -> bool:
        """Whether an estimate is possible that knows the board and the covariance of all errors."""
        return self.image is still


OUTLIER = 6.0  # px
SCENARIOS = {
    "clean": Scenario(),
    "claimed-half": Scenario(claimed=0.5),
    "correlated": Scenario(errors=partial(correlated, rms=0.06)),
    "rolling-shutter-0.2px": Scenario(image=partial(rolling_shutter, shear=0.2)),
    "rolling-shutter-0.5px": Scenario(image=partial(rolling_shutter, shear=0.5)),
    "rolling-shutter-1px": Scenario(image=partial(rolling_shutter, shear=1.0)),
    "rolling-shutter-2px": Scenario(image=partial(rolling_shutter, shear=2.0)),
    "flexing-0.1%": Scenario(image=partial(flexing, share=0.001)),
    "flexing-0.3%": Scenario(image=partial(flexing, share=0.003)),
    "blurred-3x": Scenario(errors=partial(blurred, factor=3.0)),
    "blurred-8x": Scenario(errors=partial(blurred, factor=8.0)),
    "corner-print-errors": Scenario(board=partial(corner_print_errors, share=0.003)),
    "keystone": Scenario(board=partial(keystone, share=2e-4)),
    "stretch": Scenario(board=partial(stretch, ratio=0.003)),
    "bow": Scenario(board=partial(bent, bow=(1e-3, 5e-4))),
    "twist": Scenario(board=partial(bent, bow=(0.0, 0.0), twist=5e-4)),
    "outliers": Scenario(outliers=0.01),
    "zoom-drift": Scenario(image=partial(zoom_drift, ratio=0.003)),
}


def scene(
    scenario: str | Scenario,
    count: int,
    seed: int,
    cameras: tuple[str, ...] = tuple(CAMERAS),
    claimed: float = 1.0,
    *,
    tilt: float | None = None,
) -> Scene:
    """Return `count` views of a scenario; nine seeds in a row have all combinations of three cameras and three boards.

    claimed: a factor on the standard deviations that the corners come with. tilt: of the board against the image plane
    at most, about either axis, rad; None: up to TILT from where it faces the camera.
    """
    scenario = SCENARIOS[scenario] if isinstance(scenario, str) else scenario
    setting = CAMERAS[cameras[seed % len(cameras)]]
    board = BOARDS[(seed + seed // 3) % len(BOARDS)]
    points = scenario.board(board, np.random.default_rng([seed, _BOARD]))
    views, shots, corners, covariances = [], [], [], []
    for index in range(count):
        rotation, translation = held_by_hand(
            setting,
            board,
            index % 5 in (1, 3),
            np.random.default_rng([seed, _POSE, index]),
            TILT if tilt is None else tilt,
            parallel=tilt is not None,
        )
        effect = np.random.default_rng([seed, _EFFECT, index])
        place = index / max(count - 1, 1)
        shot = Shot(setting.camera, board, points, rotation, translation, place, index, effect)
        std = NOISE * SPREAD ** (np.random.default_rng([seed, _STD, index]).uniform(-0.5, 0.5, board.count))
        noise = np.random.default_rng([seed, _NOISE, index]).normal(size=(board.count, 2))
        errors, covariance = scenario.errors(shot, noise, std)
        exact = scenario.image(shot)
        ids = np.flatnonzero(inside(setting.camera, exact))
        pixels = exact + errors
        stated = (scenario.claimed * claimed * std[ids, None, None]) ** 2 * np.eye(2)
        seen = pixels + _outliers(board.count, scenario.outliers, np.random.default_rng([seed, _OUTLIER, index]))
        views.append(BoardDetection(f"{index:03d}.png", setting.camera.image_size, ids, seen[ids], stated))
        shots.append(shot)
        corners.append(pixels[ids])
        rows = np.column_stack([2 * ids, 2 * ids + 1]).ravel()
        covariances.append(covariance[np.ix_(rows, rows)])
    known = Known(
        points,
        np.stack([shot.rotation for shot in shots]),
        np.stack([shot.translation for shot in shots]),
        tuple(view.ids for view in views),
        tuple(corners),
        tuple(covariances),
    )
    return Scene(setting.camera, board, tuple(views), known if scenario.oracle else None)


def _outliers(count: int, share: float, rng: np.random.Generator) -> np.ndarray:
    hit, angle = rng.random(count) < share, rng.uniform(0, 2 * np.pi, count)
    return np.where(hit, OUTLIER, 0.0)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def inside(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the mask of pixels (N, 2) in the image with its margin; NaN are outside."""
    return ((pixels >= MARGIN) & (pixels <= np.array(camera.image_size) - 1 - MARGIN)).all(axis=1)


def held_by_hand(
    setting: Setting,
    board: Board,
    cut: bool,
    rng: np.random.Generator,
    tilt: float = TILT,
    *,
    parallel: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Return a rotation and a translation camera_T_board with the board in the image, or enough of it if `cut`.

    tilt: the largest about either axis, from where the board faces the camera or, if `parallel`, the image plane.
    """
    camera, points = setting.camera, board.points()
    centre = np.array([*board.extent, 0.0]) / 2
    low, high = setting.fill
    fill = low * (high / low) ** rng.random()
    needed = PARTIAL_SHARE if cut else 1.0
    attempt = 0
    while True:
        aim = rng.random(2) * (np.array(camera.image_size) - 1)
        tilts, roll = rng.uniform(-tilt, tilt, 2), rng.uniform(-np.pi, np.pi)
        ray = camera.unproject(aim[None]).directions[0]
        across = np.cross([0.0, 0.0, 1.0], ray)
        sine = np.linalg.norm(across)
        facing = so3.exp(across / sine * np.arctan2(sine, ray[2]))
        lean = so3.exp(np.array([tilts[0], 0, 0])) @ so3.exp(np.array([0, tilts[1], 0]))
        facing = np.eye(3) if parallel else facing
        rotation = facing @ lean @ so3.exp(np.array([0, 0, roll]))
        attempt += 1
        scale = SHRINK ** (attempt // ATTEMPTS)
        distance = camera.parameters[0] * max(board.extent) / (fill * scale * camera.image_size[1])
        translation = distance * ray - rotation @ centre
        places = points @ rotation.T + translation
        obliquity = places @ rotation[:, 2] / np.linalg.norm(places, axis=1)
        shown = inside(camera, camera.project(places).pixels)
        if shown.mean() >= needed and (obliquity > np.cos(STEEPEST)).all():
            return rotation, translation
