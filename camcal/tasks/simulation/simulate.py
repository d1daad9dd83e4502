"""`camcal simulate`: rendered images of a board by a known camera, with ground truth.

With --raw there are mosaics in place of images, flat and dark frames, and the sensor in the truth. The folder is known
by its truth, so that another run may replace it and nothing else is touched.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from math import radians
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal import files
from camcal.cameras.catalogue import DEFAULT_MODEL, model_named
from camcal.cameras.model import Camera
from camcal.errors import CamcalError, InvalidInput
from camcal.formats import boards, cameras, detections, native, provenance
from camcal.formats.camera_file import CameraEntry, CameraFile, ValidRegion
from camcal.formats.emit import number_text
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.images.save import save
from camcal.options import command_line
from camcal.progress import SILENT, Progress, require_all
from camcal.run.fanout import fan_out
from camcal.run.outputs import OUTPUT_INDEX, claim, owned, writes
from camcal.run.paths import split_address
from camcal.simulate import mosaics
from camcal.simulate.mosaics import FixedPattern, RawCamera, Shot, even_frame, exposure_series, lenses
from camcal.simulate.render import FLAT, Shape, render
from camcal.simulate.scene import Truth, make_camera, observe, view_name, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections
from camcal.targets.pattern import pattern_of
from camcal.targets.surface import Surface
from camcal.tasks.simulation.options import RawOptions, SimulateOptions

DEFAULT_SIZE = (1280, 960)
DEFAULT_FOV = radians(70)
IMAGES = "images"
TRUTH = "truth.yaml"
BOARD = "board.yaml"
POSES = "poses.csv"
CORNERS = "corners.csv"
MAX_VIEWS = 10_000  # view names have four digits

STRONGEST_BEND = 0.05  # peak to peak, as a share of the board's larger side

_POSE_COLUMNS = ("image", "tx", "ty", "tz", "qw", "qx", "qy", "qz", "rx", "ry", "rz")

# raw frames
FLATS, DARKS = "flats", "darks"
FRAMES_A_LEVEL = 2
_DARK_EXPOSURES = (0.01, 0.1)  # without flat frames to be subtracted from
_FEW_DARKS = 4  # that few are taken at one exposure: two frames are needed to tell noise from pattern
_FLAT_STREAM, _DARK_STREAM, _PATTERN_STREAM = 1, 2, 3

MARK = "x_simulation"  # the key under which the truth says how the images were made


@dataclass(frozen=True, eq=False)
class SimulateReport:
    """What was photographed, the corners that are in the images, and the images and other frames written."""

    truth: Truth
    corners: Detections
    images: tuple[Path, ...]
    frames: tuple[Path, ...] = ()


@writes
def simulate(options: SimulateOptions, progress: Progress = SILENT) -> SimulateReport:
    """Return what was photographed after writing images and truth into options.output.

    Raises InvalidInput if the folder holds something else, or for a board, lens or scene that cannot be;
    FileError if it cannot be written.
    """
    if options.board is None:
        raise InvalidInput("a board is needed, such as chessboard:9x6:25mm; or --stereo for pairs of a scene")
    board, shape = boards.load_board(options.board), options.shape.formula
    pattern_of(board)  # a board that cannot be drawn is refused before anything is written
    _require_mild(shape, board)
    if not 1 <= options.views <= MAX_VIEWS:
        raise InvalidInput(f"{options.views} views: use 1 to {MAX_VIEWS}")
    camera = _camera(options, progress)
    rng = np.random.default_rng(options.seed)
    poses = views(camera, board, options.views, rng=rng, partial=options.partial)
    corners, truth = observe(camera, board, poses, rng=rng, shape=shape)
    folder = options.output
    require_own(folder, TRUTH)
    with owned(folder):
        claim([*(folder / name for name in (TRUTH, BOARD, POSES, CORNERS)), *_places(folder, truth)])
        _clear(folder, options.views)
        _write_truth(folder, truth, corners, options)
        images = _photograph_all(folder, truth, options, progress)
        return SimulateReport(truth, corners, images, _take_frames(folder, camera, options, progress))


def _require_mild(shape: Shape, board: Board) -> None:
    """Raise InvalidInput for a bend that is no length, or so strong that the board would hide parts of itself."""
    if board.square is None and shape != Shape(stretch=shape.stretch):
        raise InvalidInput("a bend in mm needs a board with a square size")
    deflection, limit = shape.deflection(board), STRONGEST_BEND * max(board.extent)
    if deflection > limit:
        raise InvalidInput(f"the board is bent by {1e3 * deflection:.4g} mm; use at most {1e3 * limit:.4g} mm")


def _camera(options: SimulateOptions, progress: Progress) -> Camera:
    if options.camera is None:
        if options.name is not None:
            raise InvalidInput(f"--camera {options.name} names one of a camera file, and none is given")
        model = model_named(options.model or DEFAULT_MODEL)
        return make_camera(
            model, options.size or DEFAULT_SIZE, DEFAULT_FOV if options.fov is None else options.fov, options.distortion
        )
    if any(given is not None for given in (options.model, options.size, options.fov, options.distortion)):
        raise InvalidInput("a camera file excludes --model, --size, --fov and --distortion")
    path, name = split_address(options.camera)
    known = cameras.select(cameras.read(path, progress), options.name or name, str(path)).camera
    return Camera(known.model, known.image_size, known.parameters)


def _clear(folder: Path, count: int) -> None:
    """Remove the images of an earlier run that this one does not replace."""
    kept = {view_name(index) for index in range(count)}
    for path in (folder / IMAGES).glob("view[0-9][0-9][0-9][0-9].png"):
        if path.name not in kept:
            path.unlink()
    clear_frames(folder)


def _places(folder: Path, truth: Truth) -> list[Path]:
    return [folder / IMAGES / view_name(index) for index in range(len(truth.poses))]


def _photograph_all(folder: Path, truth: Truth, options: SimulateOptions, progress: Progress) -> tuple[Path, ...]:
    items = [(path, *each) for path, each in zip(_places(folder, truth), enumerate(truth.poses), strict=True)]
    work = partial(_photograph, truth, options)
    require_all(fan_out(work, items, jobs=options.jobs, processes=True, what="rendering", progress=progress), "images")
    return tuple(path for path, _, _ in items)


def _photograph(truth: Truth, options: SimulateOptions, item: tuple[Path, int, Pose]) -> None:
    path, index, pose = item
    # A generator of its own for every view, so that the images do not depend on who renders them.
    rng = np.random.default_rng([options.seed, index])
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


def _write_truth(folder: Path, truth: Truth, corners: Detections, options: SimulateOptions) -> None:
    """Write the truth, which is known before the images; so a folder left by a killed run is known for what it is."""
    native.write(folder / TRUTH, truth_file(truth, options))
    boards.write(folder / BOARD, truth.board)
    files.write_text(folder / POSES, _poses_text(truth))
    detections.write(folder / CORNERS, corners)


def truth_file(truth: Truth, options: SimulateOptions) -> CameraFile:
    """Return the camera file of the truth: the camera, the board's shape, and how the images were made."""
    settings = {"views": options.views, "seed": options.seed, "partial": options.partial}
    how = {**settings, "exposure": asdict(options.exposure), f"shape_{truth.board.unit}": asdict(truth.shape)}
    entry = CameraEntry(truth.camera, valid=ValidRegion.of(truth.camera))
    if (raw := options.raw.camera) is not None:
        entry = truth_entry(truth.camera, raw)
        how["raw"] = how_made(options.raw)
    return CameraFile(
        {"camera": entry},
        board_shape=surface_of(truth.shape, truth.board) if truth.shape != FLAT else None,
        provenance=provenance.build(command_line("simulate", options), truth.board),
        extra={MARK: how},
    )


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


def _poses_text(truth: Truth) -> str:
    lines = [f"# camcal-poses 1 frames=camera_T_board unit={truth.board.unit}", ",".join(_POSE_COLUMNS)]
    for index, pose in enumerate(truth.poses):
        numbers = [*pose.translation, *so3.to_quaternion(pose.rotation), *pose.vector()]
        lines.append(",".join([view_name(index), *(number_text(float(number)) for number in numbers)]))
    return "\n".join(lines) + "\n"


def document(report: SimulateReport, options: SimulateOptions) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    camera, board = report.truth.camera, report.truth.board
    frames = {"frames": [path.as_posix() for path in report.frames]} if options.raw.pattern is not None else {}
    return {
        "output": options.output.as_posix(),
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


class Frame(NamedTuple):
    """A flat or dark frame to be made, and the seed of its noise."""

    path: Path
    shot: Shot
    stream: tuple[int, int]


def fixed_pattern(raw: RawCamera, size: tuple[int, int], seed: int) -> FixedPattern:
    """Return the pattern that all frames of one simulation have in common."""
    return FixedPattern.of(raw.sensor, size, np.random.default_rng([seed, 0, _PATTERN_STREAM]))


def clear_frames(folder: Path) -> None:
    """Remove the flat and dark frames of an earlier run, and the folders of exposures that they leave empty."""
    for kind in (FLATS, DARKS):
        for path in (folder / kind).glob("*s/[fd]*[0-9][0-9][0-9][0-9].png"):
            path.unlink()
        for path in [*(folder / kind).glob("*s"), folder / kind]:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def take_frames(
    folder: Path,
    raw: RawCamera,
    options: RawOptions,
    size: tuple[int, int],
    *,
    vignetting: float,
    seed: int,
    jobs: int | None,
    progress: Progress,
) -> tuple[Path, ...]:
    """Return the flat and dark frames written, a folder for each exposure, such as flats/12.5ms."""
    items = [*_flats(folder, raw, options.flats, vignetting), *_darks(folder, raw, options, vignetting)]
    work = partial(_take, raw, size, vignetting, seed)
    require_all(fan_out(work, items, jobs=jobs, processes=True, what="flats and darks", progress=progress), "frames")
    return tuple(item.path for item in items)


def _take(raw: RawCamera, size: tuple[int, int], vignetting: float, seed: int, frame: Frame) -> None:
    rng = np.random.default_rng([seed, *frame.stream])
    save(frame.path, even_frame(raw, frame.shot, vignetting, fixed=fixed_pattern(raw, size, seed), rng=rng))


def _flats(folder: Path, raw: RawCamera, levels: int, vignetting: float) -> Iterator[Frame]:
    shots = [shot for shot in exposure_series(raw, levels, vignetting) for _ in range(FRAMES_A_LEVEL)]
    for number, shot in enumerate(shots):
        yield Frame(folder / FLATS / _exposure_name(shot) / f"flat{number:04d}.png", shot, (number, _FLAT_STREAM))


def _darks(folder: Path, raw: RawCamera, options: RawOptions, vignetting: float) -> Iterator[Frame]:
    """Yield half of the frames at the shortest and half at the longest exposure of the flat frames."""
    taken = [shot.exposure_s for shot in exposure_series(raw, options.flats, vignetting)] or _DARK_EXPOSURES
    first = options.darks if options.darks < _FEW_DARKS else (options.darks + 1) // 2
    for number in range(options.darks):
        shot = Shot(taken[0] if number < first else taken[-1], 0.0)
        yield Frame(folder / DARKS / _exposure_name(shot) / f"dark{number:04d}.png", shot, (number, _DARK_STREAM))


def _exposure_name(shot: Shot) -> str:
    return f"{1e3 * shot.exposure_s:.6g}ms"


def truth_entry(camera: Camera, raw: RawCamera) -> CameraEntry:
    """Return the truth about a raw camera: its lens is that of green, red and blue have theirs under `channels`."""
    sensor = raw.sensor
    figures = {
        "gain_e_per_dn": 1 / sensor.gain_dn_per_e,
        "read_noise_e": sensor.read_noise_e,
        "full_well_e": sensor.saturation_e,
        "black_level_dn": sensor.black_dn,
        "bits": sensor.bits,
    }
    views = lenses(camera, raw.aberration_px)
    channels = {"red": views["R"], "blue": views["B"]} if raw.aberration_px else {}
    return CameraEntry(camera, valid=ValidRegion.of(camera), sensor=figures, channels=channels)


def how_made(options: RawOptions) -> dict[str, Any]:
    """Return the rest of what raw frames were made from, as plain data for the truth."""
    return {
        "pattern": options.pattern,
        "sensor": asdict(options.sensor),
        "light_rgb": list(options.light),
        "aberration_px": options.aberration_px,
        "flat_levels": options.flats,
        "dark_frames": options.darks,
    }


def require_own(folder: Path, truth: str) -> None:
    """Raise InvalidInput unless a folder is empty, new, or holds an earlier simulation; truth: its camera file."""
    if folder.exists() and not folder.is_dir():
        raise InvalidInput("is a file; expected a folder", where=str(folder))
    other = folder.is_dir() and any(path.name != OUTPUT_INDEX for path in folder.iterdir())
    if other and not _is_ours(folder / truth):
        raise InvalidInput("is not empty and not an earlier simulation; choose another folder", where=str(folder))


def _is_ours(truth: Path) -> bool:
    try:
        with files.unwatched():
            return MARK in native.read(truth).extra
    except CamcalError:
        return False
