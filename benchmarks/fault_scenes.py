"""Simulated detections of a board with one fault each, over lenses, boards and corner noises of wide ranges.

Poses, rolling shutter, flexing boards and correlated errors are those of corner_error_scenes.py, not those of
camcal.simulate. A seed has the same lens, board and noise with every fault. Corners come with their covariances in two
seeds of three.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import corner_error_scenes as scenes
import numpy as np
from corner_error_scenes import Setting, Shot

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection

NOISE = (0.03, 0.3)  # px
BOARDS = (
    Board("chessboard", 6, 5, 0.035),
    Board("chessboard", 14, 10, 0.020),
    Board("chessboard", 9, 6, 0.025),
    Board("chessboard", 7, 6, 0.040),
    Board("chessboard", 11, 8, 0.030),
    Board("chessboard", 8, 5, 0.050),
    Board("chessboard", 12, 9, 0.015),
)
_LENS, _FAULT, _ORDER = 10, 11, 12  # random generators, besides those of corner_error_scenes


def _narrow(size: tuple[int, int], focal: float) -> Setting:
    parameters = [focal, 1.002 * focal, 0.51 * size[0], 0.49 * size[1], -0.05, 0.1, 3e-4, -2e-4, 0.0]
    return Setting(Camera(model_named("opencv5"), size, np.array(parameters)), (0.4, 0.8))


def _fisheye(size: tuple[int, int], focal: float) -> Setting:
    parameters = [focal, 1.001 * focal, 0.505 * size[0], 0.49 * size[1], -0.02, 0.004, -0.001, 1e-4]
    return Setting(Camera(model_named("kannala_brandt4"), size, np.array(parameters)), (0.25, 0.5))


SETTINGS = {
    "25 degrees": _narrow((2048, 1536), 4600.0),
    "45 degrees": _narrow((1920, 1080), 2300.0),
    "70 degrees": scenes.CAMERAS["opencv5-1600x1200"],
    "65 degrees, 640x480": scenes.CAMERAS["opencv5-640x480"],
    "120 degrees": _fisheye((1280, 800), 600.0),
    "175 degrees": scenes.CAMERAS["kannala_brandt4-1280x960"],
}


@dataclass(frozen=True, eq=False)
class Case:
    """What a calibration is given, and the true camera. board: as it is given."""

    truth: Camera
    board: Board
    views: tuple[BoardDetection, ...]


Image = Callable[[Shot], np.ndarray]
Errors = Callable[[Shot, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
Table = Callable[[Case, np.random.Generator], Case]


def _same(case: Case, _: np.random.Generator) -> Case:
    return case


@dataclass(frozen=True)
class Fault:
    """What is wrong. image: how a board is imaged. errors: of corners. table: what is done to the detections.

    names: codes of findings that name it, or words of the message by which a calibration is refused. tilt_deg: the
    largest tilt about either axis.
    """

    names: tuple[str, ...] = ()
    image: Image = scenes.still
    errors: Errors = scenes.independent
    table: Table = _same
    tilt_deg: float = 45.0
    parallel: bool = False
    views: int | None = None


def case(fault: Fault, count: int, seed: int) -> Case:
    """Return the case of a seed with a number of views."""
    rng = np.random.default_rng([seed, _LENS])
    setting = list(SETTINGS.values())[seed % len(SETTINGS)]
    board = BOARDS[(seed + seed // len(SETTINGS)) % len(BOARDS)]
    noise = NOISE[0] * (NOISE[1] / NOISE[0]) ** rng.random()
    views = tuple(
        _view(fault, setting, board, noise, seed, index, index / max(count - 1, 1))
        for index in range(fault.views or count)
    )
    found = Case(setting.camera, board, views)
    return fault.table(found, np.random.default_rng([seed, _FAULT]))


def _view(
    fault: Fault, setting: Setting, board: Board, noise: float, seed: int, index: int, place: float
) -> BoardDetection:
    camera = setting.camera
    cut = index % 5 in (1, 3)
    rotation, translation = scenes.held_by_hand(
        setting,
        board,
        cut,
        np.random.default_rng([seed, 0, index]),
        np.radians(fault.tilt_deg),
        parallel=fault.parallel,
    )
    effect = np.random.default_rng([seed, 4, index])
    shot = Shot(camera, board, board.points(), rotation, translation, place, index, effect)
    rng = np.random.default_rng([seed, 2, index])
    std = noise * scenes.SPREAD ** rng.uniform(-0.5, 0.5, board.count)
    exact = fault.image(shot)
    errors, _ = fault.errors(shot, rng.normal(size=(board.count, 2)), std)
    ids = np.flatnonzero(scenes.inside(camera, exact))
    covariance = None if seed % 3 == 2 else std[ids, None, None] ** 2 * np.eye(2) * (1.0, 0.5)[seed % 3]
    return BoardDetection(f"{index:03d}.png", camera.image_size, ids, (exact + errors)[ids], covariance)


# what a view shows


def zoom_step(shot: Shot, ratio: float, at: float = 0.5) -> np.ndarray:
    """Return pixels by a focal length that is larger by a ratio after a place in the set."""
    return _zoomed(shot, ratio * (shot.place > at))


def zoom_drift(shot: Shot, ratio: float) -> np.ndarray:
    """Return pixels by a focal length that changes linearly by a ratio up to the last view."""
    return _zoomed(shot, ratio * shot.place)


def refocused(shot: Shot, ratio: float) -> np.ndarray:
    """Return pixels by a focal length of its own for every view."""
    return _zoomed(shot, ratio * shot.rng.normal())


def zoomed_views(shot: Shot, ratio: float, views: Sequence[int] = (4, 11)) -> np.ndarray:
    """Return pixels by a focal length that is larger by a ratio in some views."""
    return _zoomed(shot, ratio * (shot.index in views))


def _zoomed(shot: Shot, change: float) -> np.ndarray:
    parameters = shot.camera.parameters.copy()
    parameters[:2] *= 1 + change
    return scenes.still(replace(shot, camera=replace(shot.camera, parameters=parameters)))


def two_boards(shot: Shot, stretch: float = 0.0, corners: float = 0.0, bow: float = 0.0, *, mixed: bool = False):
    """Return pixels of a second board in the later half of the views, or in every second one."""
    second = shot.index % 2 == 1 if mixed else shot.place > 0.5
    points = shot.points * [1 + stretch * second, 1, 1]
    if second and corners:
        points = points + shot.board.spacing * np.random.default_rng(5).normal(0, corners, points.shape) * [1, 1, 0]
    if second and bow:
        half = np.array(shot.board.extent) / 2
        x, y = ((shot.points[:, :2] - half) / half).T
        points = points + bow * max(shot.board.extent) * np.outer(1 - (x**2 + y**2) / 2, [0, 0, 1])
    return shot.project(points)


def two_cameras(shot: Shot) -> np.ndarray:
    """Return pixels of another lens in the later half of the views."""
    parameters = shot.camera.parameters.copy()
    if shot.place > 0.5:
        parameters[:4] *= [1.04, 1.04, 0.985, 1.02]
        parameters[4] += 0.02
    return scenes.still(replace(shot, camera=replace(shot.camera, parameters=parameters)))


# what is done to detections


def _changed(case: Case, change: Callable[[int, BoardDetection], BoardDetection]) -> Case:
    return replace(case, views=tuple(change(index, view) for index, view in enumerate(case.views)))


def rows_rolled(case: Case, _: np.random.Generator) -> Case:
    """Return a case whose ids are one row off in two views."""
    columns, rows = case.board.columns, case.board.rows

    def rolled(index: int, view: BoardDetection) -> BoardDetection:
        if index not in (3, 8):
            return view
        ids = (view.ids + columns) % (columns * rows)
        return replace(view, ids=ids)

    return _changed(case, rolled)


def shuffled(case: Case, rng: np.random.Generator) -> Case:
    return _changed(case, lambda i, view: replace(view, ids=rng.permutation(view.ids)) if i == 3 else view)


def view_scaled(case: Case, _: np.random.Generator, ratio: float = 1.03) -> Case:
    """Return a case with one view that was scaled, more so along its rows."""
    middle, scale = np.array(case.truth.image_size) / 2, ratio * np.array([1, 0.94])

    def scaled(index: int, view: BoardDetection) -> BoardDetection:
        return view if index != 5 else replace(view, pixels=middle + scale * (view.pixels - middle))

    return _changed(case, scaled)


def wrong_columns(case: Case, _: np.random.Generator) -> Case:
    """Return a case of a board of one column fewer than the ids were counted by."""
    columns, rows = case.board.columns, case.board.rows
    board = replace(case.board, columns=columns + 1, rows=rows)
    return replace(case, board=board)


def in_metres(case: Case, _: np.random.Generator) -> Case:
    """Return a case of a board whose size in mm was given in m."""
    return replace(case, board=replace(case.board, square=1e3 * (case.board.square or 0.0)))


def gross(case: Case, rng: np.random.Generator, share: float) -> Case:
    def moved(_: int, view: BoardDetection) -> BoardDetection:
        hit = rng.random(len(view.ids)) < share
        return replace(view, pixels=view.pixels + hit[:, None] * rng.normal(0, 25, view.pixels.shape))

    return _changed(case, moved)


def in_order(case: Case, _: np.random.Generator) -> Case:
    """Return a case whose views are sorted by where the board is, as it is when a board is moved along."""
    return replace(case, views=tuple(sorted(case.views, key=lambda view: float(view.pixels[:, 0].mean()))))


_PAIR = ("several_cameras", "two cameras", "several cameras", "focal_change")
FAULTS = {
    "zoom step 0.5 %": Fault(("focal_change", "focal_varies"), partial(zoom_step, ratio=0.005)),
    "zoom step 0.2 %": Fault(("focal_change", "focal_varies"), partial(zoom_step, ratio=0.002)),
    "zoom step 3 %, a third": Fault(("focal_change", "focal_varies"), partial(zoom_step, ratio=0.03, at=0.67)),
    "zoom drift 0.5 %": Fault(("focal_change", "focal_varies"), partial(zoom_drift, ratio=0.005)),
    "two views zoomed 1 %": Fault(("focal_change", "focal_varies"), partial(zoomed_views, ratio=0.01)),
    "refocused 0.3 %": Fault(("focal_change", "focal_varies"), partial(refocused, ratio=0.003)),
    "rolling shutter 2 px": Fault(("rolling_shutter",), partial(scenes.rolling_shutter, shear=2.0)),
    "flexing 0.1 %": Fault(("board_bends",), partial(scenes.flexing, share=0.001)),
    "two boards, stretch 0.3 %": Fault(("two_boards",), partial(two_boards, stretch=0.003)),
    "two boards in turn, stretch": Fault(("two_boards",), partial(two_boards, stretch=0.003, mixed=True)),
    "two boards, corners 0.3 %": Fault(("two_boards",), partial(two_boards, corners=0.003)),
    "two boards in turn, corners": Fault(("two_boards",), partial(two_boards, corners=0.003, mixed=True)),
    "two boards, bow 0.3 %": Fault(("two_boards", "board_bends"), partial(two_boards, bow=0.003)),
    "blurred 3x": Fault(("motion_blur",), errors=partial(scenes.blurred, factor=3.0)),
    "blurred 8x": Fault(("motion_blur", "leave out"), errors=partial(scenes.blurred, factor=8.0)),
    "two cameras": Fault(_PAIR, two_cameras),
    "rows of ids rolled": Fault(("rejected", "leave out"), table=rows_rolled),
    "shuffled ids": Fault(("rejected", "leave out"), table=shuffled),
    "view scaled 3 %": Fault(("rejected", "leave out", "focal_varies"), table=view_scaled),
    "wrong columns": Fault(("columns", "ids"), table=wrong_columns),
    "gross corners 15 %": Fault(("corners",), table=partial(gross, share=0.15)),
    "5 views": Fault(("few_views",), views=5),
    "tilt 7 degrees": Fault(("known_region", "tilt"), tilt_deg=7.0, parallel=True),
    "tilt 4 degrees": Fault(("known_region", "tilt"), tilt_deg=4.0, parallel=True),
    "mm taken as m": Fault(("board_size",), table=in_metres),
}
CLEAN = {
    "clean": Fault(),
    "sorted": Fault(table=in_order),
    "correlated": Fault(errors=partial(scenes.correlated, rms=0.06)),
    "rolling shutter 0.2 px": Fault(image=partial(scenes.rolling_shutter, shear=0.2)),
    "rolling shutter 0.7 px": Fault(image=partial(scenes.rolling_shutter, shear=0.7)),
    "rolling shutter 2 px": Fault(image=partial(scenes.rolling_shutter, shear=2.0)),
    "flexing 0.03 %": Fault(image=partial(scenes.flexing, share=0.0003)),
    "flexing 0.2 %": Fault(image=partial(scenes.flexing, share=0.002)),
}
