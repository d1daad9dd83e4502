"""`camcal simulate`: rendered images of a board by a known camera, with ground truth.

With --raw there are mosaics in place of images, flat and dark frames, and the sensor in the truth. Of the cameras of a
rig each has a folder of images. The folder is known by its truth, so that another run may replace it and nothing else
is touched.
"""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal import files, system
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.model import Camera, require_central
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import boards, cameras, detections, native, poses, provenance, split_address
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, ValidRegion, rig_of
from camcal.formats.poses import PoseKey, PoseRecord
from camcal.formats.poses.record import PixelNoise
from camcal.geometry.pose import Pose
from camcal.images.files import save
from camcal.options import command_line
from camcal.progress import SILENT, Progress, require_all
from camcal.run.fanout import fan_out
from camcal.run.fingerprint import MANIFEST
from camcal.run.outputs import claim, owned, writes
from camcal.simulate import mosaics
from camcal.simulate.render import FLAT, Shape, render
from camcal.simulate.scene import Truth, captures, make_camera, motion, observe, seen_by, view_name, views
from camcal.targets.board import Board, Surface
from camcal.targets.detection import Detections
from camcal.targets.pattern import pattern_of
from camcal.tasks.given_camera import read_part
from camcal.tasks.simulation.frames import clear_frames, fixed_pattern, how_made, take_frames, truth_entry
from camcal.tasks.simulation.options import SimulateOptions

DEFAULT_SIZE = (1280, 960)
DEFAULT_FOV = radians(70)
IMAGES = "images"
TRUTH = "truth.yaml"
BOARD = "board.yaml"
POSES = "poses.csv"
CORNERS = "corners.csv"
MIN_CAMERAS = 2  # of a rig
MAX_VIEWS = 10_000  # view names have four digits

STRONGEST_BEND = 0.05  # peak to peak, as a share of the board's larger side

MARK = "x_simulation"  # the key under which the truth says how the images were made


@dataclass(frozen=True, eq=False)
class SimulateReport:
    """What was photographed, the corners that are in the images, and the images and other frames written.

    truth: of the first camera, where there are several; cameras: their names, none of a single one.
    """

    truth: Truth
    corners: Detections
    images: tuple[Path, ...]
    frames: tuple[Path, ...] = ()
    cameras: tuple[str, ...] = ()


class Scene(NamedTuple):
    """What one camera photographs: the camera's name, none of a single one, and the numbers of the views."""

    name: str
    truth: Truth
    corners: Detections
    numbers: tuple[int, ...]

    def image(self, view: int) -> str:
        """Return the name of a view's image, with the folder of the camera."""
        return f"{self.name}/{view_name(self.numbers[view])}" if self.name else view_name(self.numbers[view])


@writes
def simulate(options: SimulateOptions, progress: Progress = SILENT) -> SimulateReport:
    """Return what was photographed after writing images and truth into options.output.

    Raises InvalidInput if the folder holds something else, or for a board, lens or scene that cannot be;
    FileError if it cannot be written.
    """
    if options.board is None:
        raise InvalidInput("a board is needed, such as chessboard:9x6:25mm; or --stereo for pairs of a scene")
    board = boards.load_board(options.board)
    pattern_of(board)  # a board that cannot be drawn is refused before anything is written
    shape = options.shape.formula
    if board.square is None and shape != Shape(stretch=shape.stretch):
        raise InvalidInput("a bend in mm needs a board with a square size")
    deflection, limit = shape.deflection(board), STRONGEST_BEND * max(board.extent)
    if deflection > limit:
        raise InvalidInput(f"the board is bent by {1e3 * deflection:.4g} mm; use at most {1e3 * limit:.4g} mm")
    if not 1 <= options.views <= MAX_VIEWS:
        raise InvalidInput(f"{options.views} views: use 1 to {MAX_VIEWS}")
    rig = _rig(options, progress)
    scenes = _single(options, board, progress) if rig is None else _scenes_of_rig(rig, options, board)
    folder = options.output
    require_own(folder, TRUTH)
    with owned(folder):
        places = dict.fromkeys(_places(folder, scenes))
        claim([*(folder / name for name in (TRUTH, BOARD, POSES, CORNERS)), *places])
        for path in (folder / IMAGES).rglob("view[0-9][0-9][0-9][0-9].png"):
            if path not in places:  # of an earlier run, which this one does not replace
                path.unlink()
        clear_frames(folder)
        corners = _write_truth(folder, scenes, rig, options)
        images = _photograph_all(folder, scenes, options, progress)
        frames = _take_frames(folder, scenes[0].truth.camera, options, progress)
        return SimulateReport(scenes[0].truth, corners, images, frames, () if rig is None else tuple(rig.cameras))


def _rig(options: SimulateOptions, progress: Progress) -> CameraFile | None:
    """Return the camera file if it holds several cameras and none of them is chosen."""
    if options.camera is None:
        return None
    path, name = split_address(options.camera)
    file = read_part(path, options.part, progress)
    if options.name or name or len(file.cameras) < MIN_CAMERAS:
        return None
    _require_no_lens(options)
    if options.motion or options.raw.flats or options.raw.darks:
        raise InvalidInput(
            "--motion, --flats and --darks are of one camera: choose it with --camera", where=options.camera
        )
    return file


def _single(options: SimulateOptions, board: Board, progress: Progress) -> list[Scene]:
    camera, rng = _camera(options, progress), np.random.default_rng(options.seed)
    if options.motion:
        poses = motion(camera, board, options.views, rng=rng)
    else:
        poses = views(camera, board, options.views, rng=rng, partial=options.partial)
    corners, truth = observe(camera, board, poses, rng=rng, shape=options.shape.formula)
    return [Scene("", truth, corners, tuple(range(options.views)))]


def _scenes_of_rig(file: CameraFile, options: SimulateOptions, board: Board) -> list[Scene]:
    """Return what each camera of a rig photographs: the captures in which it sees the board."""
    rng = np.random.default_rng(options.seed)
    rig, _ = rig_of(file, options.camera or "")
    poses = captures(rig, board, options.views, rng=rng, partial=options.partial)
    scenes = []
    for name, known in rig.cameras.items():
        camera, camera_T_rig = Camera(known.model, known.image_size, known.parameters), rig.rig_T_camera[name].inverse()
        numbers = tuple(map(int, np.flatnonzero(seen_by(rig, name, board, poses, partial=True))))
        own = [camera_T_rig @ poses[number] for number in numbers]
        found, truth = observe(camera, board, own, rng=rng, shape=options.shape.formula)
        scenes.append(Scene(name, truth, found, numbers))
    return scenes


def _camera(options: SimulateOptions, progress: Progress) -> Camera:
    if options.camera is None:
        if options.name is not None:
            raise InvalidInput(f"--camera {options.name} names one of a camera file, and none is given")
        model = model_named(options.model or DEFAULT_MODEL)
        require_central(model)
        return make_camera(
            model, options.size or DEFAULT_SIZE, DEFAULT_FOV if options.fov is None else options.fov, options.distortion
        )
    _require_no_lens(options)
    path, name = split_address(options.camera)
    known = cameras.select(read_part(path, options.part, progress), options.name or name, str(path)).camera
    return Camera(known.model, known.image_size, known.parameters)


def _require_no_lens(options: SimulateOptions) -> None:
    """Raise InvalidInput for a lens that is described beside a camera file."""
    if any(given is not None for given in (options.model, options.size, options.fov, options.distortion)):
        raise InvalidInput("a camera file excludes --model, --size, --fov and --distortion")


def _places(folder: Path, scenes: Sequence[Scene]) -> list[Path]:
    return [folder / IMAGES / scene.image(view) for scene in scenes for view in range(len(scene.numbers))]


def _photograph_all(
    folder: Path, scenes: Sequence[Scene], options: SimulateOptions, progress: Progress
) -> tuple[Path, ...]:
    """Return the images rendered.

    Every one has a random generator of its own, so that it does not depend on who renders it.
    """
    seeds = [
        [options.seed, number, *[place] * (place > 0)] for place, scene in enumerate(scenes) for number in scene.numbers
    ]
    shots = [(scene.truth, pose) for scene in scenes for pose in scene.truth.poses]
    items = [(*each, *shot) for *each, shot in zip(_places(folder, scenes), seeds, shots, strict=True)]
    work = partial(_photograph, options)
    require_all(fan_out(work, items, jobs=options.jobs, processes=True, what="rendering", progress=progress), "images")
    return tuple(_places(folder, scenes))


def _photograph(options: SimulateOptions, item: tuple[Path, list[int], Truth, Pose]) -> None:
    path, seed, truth, pose = item
    rng = np.random.default_rng(seed)
    camera, board, shape, exposure = truth.camera, truth.board, truth.shape, options.exposure
    raw = options.raw.camera
    if raw is None:
        save(path, render(camera, board, pose, rng=rng, exposure=exposure, shape=shape))
        return
    fixed = fixed_pattern(raw, camera.image_size, options.seed)
    save(path, mosaics.photograph(raw, camera, board, pose, exposure=exposure, shape=shape, fixed=fixed, rng=rng))


def _take_frames(folder: Path, camera: Camera, options: SimulateOptions, progress: Progress) -> tuple[Path, ...]:
    raw = options.raw.camera
    if raw is None:
        return ()
    return take_frames(
        folder,
        raw,
        options.raw,
        camera.image_size,
        vignetting=options.vignetting,
        seed=options.seed,
        jobs=options.jobs,
        progress=progress,
    )


def _write_truth(folder: Path, scenes: Sequence[Scene], rig: CameraFile | None, options: SimulateOptions) -> Detections:
    """Return the corners of all images after writing the truth.

    It is known before the images, so that a folder left by a killed run is known for what it is.
    """
    board = scenes[0].truth.board
    corners = [
        replace(view, camera=scene.name, image=scene.image(index))
        for scene in scenes
        for index, view in enumerate(scene.corners.views)
    ]
    native.write(folder / TRUTH, truth_file(scenes, rig, options))
    boards.write(folder / BOARD, board)
    poses.write(folder / POSES, _true_poses(scenes))
    detections.write(folder / CORNERS, found := Detections(board, tuple(corners)))
    return found


def truth_file(scenes: Sequence[Scene], rig: CameraFile | None, options: SimulateOptions) -> CameraFile:
    """Return the camera file of the truth: the cameras, the board's shape, and how the images were made."""
    truth = scenes[0].truth
    settings = {"views": options.views, "seed": options.seed, "partial": options.partial}
    settings |= {"motion": True} if options.motion else {}
    how = {**settings, "exposure": asdict(options.exposure), f"shape_{truth.board.unit}": asdict(truth.shape)}
    entries = {scene.name or "camera": _entry(scene.truth.camera, options) for scene in scenes}
    if options.raw.pattern is not None:
        how["raw"] = how_made(options.raw)
    return CameraFile(
        entries,
        transforms={name: Transform(each.pose) for name, each in rig.transforms.items()} if rig else {},
        board_shape=surface_of(truth.shape, truth.board) if truth.shape != FLAT else None,
        provenance=provenance.build(command_line("simulate", options), truth.board),
        extra={MARK: how},
    )


def _entry(camera: Camera, options: SimulateOptions) -> CameraEntry:
    raw = options.raw.camera
    return CameraEntry(camera, valid=ValidRegion.of(camera)) if raw is None else truth_entry(camera, raw)


def surface_of(shape: Shape, board: Board) -> Surface:
    """Return a shape in the terms that calibration estimates: the same but for what a pose or a scale can take."""
    terms = {
        "xy": shape.twist,
        "P2(x)": -2 / 3 * shape.bow_x,  # 1 - x² = 2/3 - 2/3 P2(x)
        "P2(y)": -2 / 3 * shape.bow_y,
        "P3(x)": 2 / 5 * shape.cubic,  # x³ - x = 2/5 P3(x) - 2/5 x
        "x/y scale": 2 * shape.stretch / (2 + shape.stretch),
        "shear": 0.0,
    }
    return Surface(
        board,
        ("bow", "cubic", "stretch"),
        tuple(terms),
        np.array(list(terms.values())),
        np.zeros((len(terms), len(terms))),
        deflection=shape.deflection(board),
    )


def _true_poses(scenes: Sequence[Scene]) -> poses.Poses:
    """Return the poses of the board in all images, as `camcal pnp` would find them without any error."""
    exact = np.zeros((6, 6))
    estimates = {
        PoseKey(scene.image(index)): PoseRecord(
            pose, exact, exact, "ok", rms_px=0.0, max_px=0.0, n_points=len(view.ids), n_inliers=len(view.ids)
        )
        for scene in scenes
        for index, (pose, view) in enumerate(zip(scene.truth.poses, scene.corners.views, strict=True))
    }
    return poses.Poses("camera_T_object", scenes[0].truth.board.unit, PixelNoise(0.0), estimates)


def document(report: SimulateReport, options: SimulateOptions) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    camera, board = report.truth.camera, report.truth.board
    frames = {"frames": [path.as_posix() for path in report.frames]} if options.raw.pattern is not None else {}
    rig = {"cameras": list(report.cameras)} if report.cameras else {}
    return {
        "output": options.output.as_posix(),
        **rig,
        "model": camera.model.name,
        "image_size": list(camera.image_size),
        "parameters": {name: camera.value(name) for name in camera.model.parameter_names},
        "board": boards.block(board),
        "deflection": report.truth.shape.deflection(board),
        "unit": board.unit,
        "images": [path.as_posix() for path in report.images],
        "corners": sum(len(view.ids) for view in report.corners.views),
        **frames,
    }


def require_own(folder: Path, truth: str) -> None:
    """Raise InvalidInput unless a folder is empty, new, or holds an earlier simulation; truth: its camera file."""
    if folder.exists() and not folder.is_dir():
        raise InvalidInput("is a file; expected a folder", where=str(folder))
    other = folder.is_dir() and any(path.name not in (MANIFEST, system.HELD) for path in folder.iterdir())
    if other and not _is_ours(folder / truth):
        raise InvalidInput("is not empty and not an earlier simulation; choose another folder", where=str(folder))


def _is_ours(truth: Path) -> bool:
    try:
        with files.unwatched():
            return MARK in native.read(truth).extra
    except CamcalError:
        return False
