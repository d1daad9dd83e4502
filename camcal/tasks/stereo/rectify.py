"""`camcal stereo rectify`: rectified pairs of images and videos, their camera file, masks and maps."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files, records
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.formats import native, pair_calibration, split_address
from camcal.formats.cameras import ros
from camcal.images.files import load, save
from camcal.images.video import frames
from camcal.options import command_line
from camcal.progress import SILENT, Outcome, Progress, failed_items, reused
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_media, paired, refuse_collisions
from camcal.stereo.options import RectifiedViewOptions
from camcal.stereo.rectify.plan import PairMaps, build_pair_maps
from camcal.stereo.rectify.record import Rectification
from camcal.tasks.calibration.drawing import Drawing, Drawn, Sources, require_success
from camcal.tasks.calibration.undistort import suffix_of
from camcal.tasks.given_camera import require_no_image
from camcal.tasks.stereo.rig_pair import GivenRig, read_rig, rectified_file
from camcal.tasks.stereo.run_options import RectifyOptions

CAMERA_FILE, MAPS_FILE, OPENCV_FILE, ROS_FOLDER = "rectified.yaml", "maps.npz", "opencv.yml", "ros"
_FRAME_SUFFIX = ".jpg"

Pair = tuple[Path, Path]


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Images and videos that belong together, of the first and the second camera."""

    images: tuple[Pair, ...] = ()
    videos: tuple[Pair, ...] = ()


@dataclass(frozen=True)
class Beside:
    """The files beside the images; None and nothing for those that are not asked for."""

    camera_file: Path
    masks: tuple[Path, Path]
    maps: Path | None
    opencv: Path | None
    ros: tuple[Path, ...]

    @classmethod
    def of(cls, options: RectifyOptions, found: Rectification) -> "Beside":
        """Return the files that the options ask for."""
        folder, names = options.output, (found.left, found.right)
        return cls(
            folder / CAMERA_FILE,
            (folder / f"{names[0]}_mask.png", folder / f"{names[1]}_mask.png"),
            folder / MAPS_FILE if options.maps else None,
            folder / OPENCV_FILE if options.opencv else None,
            tuple(folder / ROS_FOLDER / f"{name}.yaml" for name in names) if options.ros else (),
        )

    @property
    def all(self) -> tuple[Path, ...]:
        """All of them."""
        some = (path for path in (self.maps, self.opencv) if path is not None)
        return (self.camera_file, *self.masks, *some, *self.ros)


@dataclass(frozen=True, eq=False)
class RectifyReport:
    """How a pair was rectified, what became of every image, and the files beside the images.

    outcomes: by the names of cameras. valid: shares of the pixels that have a source, likewise.
    """

    rectification: Rectification
    outcomes: Mapping[str, Sequence[Outcome[Path, Drawn]]]
    beside: Beside
    valid: Mapping[str, float]

    @property
    def images(self) -> tuple[Outcome[Path, Drawn], ...]:
        """What became of the images of both cameras."""
        return tuple(outcome for each in self.outcomes.values() for outcome in each)

    @property
    def failed(self) -> tuple[Outcome[Path, Drawn], ...]:
        return tuple(outcome for outcome in self.images if outcome.error is not None)


@writes
def rectify(options: RectifyOptions, progress: Progress = SILENT) -> RectifyReport:
    """Return what became of every image after writing what can be written to options.output.

    Raises InvalidInput for cameras that no transform joins, InsufficientData for a pair that cannot be rectified,
    FileError; and the first image's error when there is none that could be written.
    """
    require_no_image(split_address(options.rig)[0])
    pairs = _pairs(options)
    rig = read_rig(options.rig, options.cameras, lambda: _first_size(pairs), options.second, options.given, progress)
    found = _plan(options, rig, progress)
    outputs = _places(options, pairs, rig.names)
    beside = Beside.of(options, found)
    claim([*(path for each in outputs.values() for path in each.values()), *beside.all])
    maps = build_pair_maps(rig.cameras, found, options.interpolation, rig.circles)
    drawing = Drawing({found.left: maps.left, found.right: maps.right}, quality=options.quality)
    sources = {name: Sources(outputs[name], videos) for name, videos in _videos(options, pairs, rig.names).items()}
    outcomes: dict[str, list[Outcome[Path, Drawn]]] = {name: [] for name in rig.names}
    for name, outcome in drawing.outcomes(sources, options.jobs, options.batch, progress):
        outcomes[name].append(outcome)
    require_success([outcome for each in outcomes.values() for outcome in each])
    _write_beside(beside, options, rig, found, maps)
    valid = dict(zip((found.left, found.right), (float(mask.mean()) for mask in maps.valid), strict=True))
    return RectifyReport(found, outcomes, beside, valid)


def _plan(options: RectifyOptions, rig: GivenRig, progress: Progress) -> Rectification:
    """Return how the pair is rectified, after giving its warnings; of images for ROS in the size of the camera's."""
    view = _view_for_ros(options.view, rig) if options.ros else options.view
    found = rig.rectification(view)
    for warning in found.warnings:
        progress.warn(warning.at(options.rig))
    if options.opencv:
        pair_calibration.require_pinhole(found, "--opencv")
    if options.ros:
        pair_calibration.require_pinhole(found, "--ros")
    return found


def _view_for_ros(view: RectifiedViewOptions, rig: GivenRig) -> RectifiedViewOptions:
    sizes = {camera.image_size for camera in rig.cameras.values()}
    if len(sizes) > 1 or view.size not in (None, *sizes) or view.scale is not None:
        raise InvalidInput("--ros: rectified images have the size of the camera's, the same for both", where="--ros")
    return replace(view, size=sizes.pop())


def _pairs(options: RectifyOptions) -> _Pairs:
    """Return what belongs together of both sides; nothing where no images are given."""
    if not options.left:
        return _Pairs()
    left, right = (find_media(side, options.recursive) for side in (options.left, options.right))
    images = paired(left.images, right.images, ("left", "right images"))
    if len(left.videos) != len(right.videos):
        raise InvalidInput(f"{len(left.videos)} left and {len(right.videos)} right videos differ")
    found = _Pairs(tuple(images), tuple(zip(left.videos, right.videos, strict=True)))
    for first, second in (*found.images, *found.videos):
        if first.resolve() == second.resolve():
            raise InvalidInput("is given as the left and as the right image", where=str(first))
    return found


def _first_size(pairs: _Pairs) -> tuple[int, int] | None:
    for path, _ in pairs.images:
        return load(path).size
    for path, _ in pairs.videos:
        return next(frames(path)).size
    return None


def _places(options: RectifyOptions, pairs: _Pairs, names: tuple[str, str]) -> dict[str, dict[Path, Path]]:
    """Return the file for every image, in a folder for each camera."""
    found = {}
    for side, name in enumerate(names):
        sources = [pair[side] for pair in pairs.images]
        found[name] = {
            path: options.output / name / f"{path.stem}{suffix_of(path, options.format)}" for path in sources
        }
        refuse_collisions(found[name])
    return found


def _videos(options: RectifyOptions, pairs: _Pairs, names: tuple[str, str]) -> dict[str, dict[Path, Path]]:
    """Return the file that the frames of every video are named by, in a folder for each camera."""
    suffix = f".{options.format}" if options.format else _FRAME_SUFFIX
    return {
        name: {pair[side]: options.output / name / f"{pair[side].stem}{suffix}" for pair in pairs.videos}
        for side, name in enumerate(names)
    }


def _write_beside(beside: Beside, options: RectifyOptions, rig: GivenRig, found: Rectification, maps: PairMaps) -> None:
    """Write the camera file, the masks and what else is asked for."""
    for path, mask in zip(beside.masks, maps.valid, strict=True):
        save(path, np.where(mask, 255, 0).astype(np.uint8))
    if beside.maps is not None:
        arrays: dict[str, Any] = dict(maps.arrays((found.left, found.right)))
        masks = zip((found.left, found.right), maps.valid, strict=True)
        arrays |= {f"{name}_valid": mask for name, mask in masks}
        with files.replacing(beside.maps) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)
    if beside.opencv is not None:
        pair_calibration.write_opencv(beside.opencv, found)
    if beside.ros:
        pose = rig.pose(found.right, found.left)
        ros.write(beside.ros[0].parent, pair_calibration.as_ros(rig.file, found, pose))
    native.write(beside.camera_file, rectified_file(rig, found, command_line("stereo rectify", options)))


def document(report: RectifyReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    found = report.rectification
    return {
        **records.document(report.beside),
        "projection": found.projection,
        "axis": found.axis,
        "left": found.left,
        "right": found.right,
        "swapped": found.swapped,
        "image_size": found.size,
        "focal": found.focal,
        "left_centre": found.left_centre,
        "right_centre": found.right_centre,
        "baseline": found.baseline,
        "kept": found.kept,
        "rect_R_left": found.rect_R_left,
        "rect_R_right": found.rect_R_right,
        "valid": report.valid,
        "warnings": found.warnings,
        "images": [
            {"camera": name, "source": outcome.item, "frame": drawn.frame, "output": drawn.output}
            for name, each in report.outcomes.items()
            for outcome in each
            if (drawn := outcome.value) is not None
        ],
        "reused": reused(report.images),
        "failed": failed_items(report.failed, "source"),
    }
