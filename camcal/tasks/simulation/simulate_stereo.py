"""`camcal simulate --stereo`: rendered rectified pairs with exact disparity."""

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from math import degrees, pi, radians, tan
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.formats import disparity, disparity_sidecar, native, provenance
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, ValidRegion
from camcal.formats.disparity_sidecar import Sidecar
from camcal.images.files import save
from camcal.options import command_line
from camcal.progress import SILENT, Progress, require_all
from camcal.run.fanout import fan_out
from camcal.run.outputs import claim, owned, writes
from camcal.simulate.stereo_scene import PairOptions, StereoTruth, render_pair
from camcal.stereo.disparity import StereoGeometry, of_pair
from camcal.tasks.simulation import simulate
from camcal.tasks.simulation.options import PairsOptions, SimulateOptions

DEFAULT_FOV = radians(60)
DEFAULT_DISPARITIES = (0.01, 0.1)  # shares of the width

RIG = "rig.yaml"
LEFT, RIGHT, DISPARITY, DISPARITY_RIGHT, VISIBLE = FOLDERS = "left", "right", "disparity", "disparity_right", "visible"
MAX_PAIRS = 1000  # their names have three digits


@dataclass(frozen=True)
class PairFiles:
    """The files of a pair, the disparities in it, pixels, and the share of the left pixels that both cameras see."""

    left: Path
    right: Path
    disparity: Path
    disparity_right: Path
    visible: Path
    least: float
    greatest: float
    shared: float


@dataclass(frozen=True)
class StereoReport:
    """The pairs that were written, their size (width, height), their camera file, what turns disparity into depth."""

    rig: Path
    size: tuple[int, int]
    geometry: StereoGeometry
    pairs: tuple[PairFiles, ...]


def pair_options(options: SimulateOptions) -> PairOptions:
    """Return how pairs are made from what people know of cameras and scenes.

    Raises InvalidInput for what contradicts itself or cannot be.
    """
    given = options.pairs
    size, fov = options.size or PairOptions.size, DEFAULT_FOV if options.fov is None else options.fov
    if not 0 < fov < pi:
        raise InvalidInput(
            f"a pinhole cannot have a field of view of {degrees(fov):g}°; use more than 0 and less than 180"
        )
    others = {
        "baseline": given.baseline,
        "doffs": given.doffs,
        "objects": given.objects,
        "blur": options.blur,
        "noise": options.noise,
        "gain": given.right_gain,
        "offset": given.right_offset,
        "gamma": given.right_gamma,
        "row_shift": given.row_shift,
        "row_tilt": given.row_tilt,
        "depth": options.depth,
    }
    known: dict[str, Any] = {name: value for name, value in others.items() if value is not None}
    focal = size[0] / 2 / tan(fov / 2)
    disparities = _disparities(given, size[0], focal)
    return PairOptions(size, focal, disparities=disparities, colour=not given.gray, **known)


def _disparities(given: PairsOptions, width: int, focal: float) -> tuple[float, float]:
    """Return the least and the greatest disparity (px), as given, by the distances, or by default."""
    if given.disparities is not None and given.distance is not None:
        raise InvalidInput("disparities and distances are redundant; leave one out")
    if given.distance is not None:
        near, far = given.distance
        if not 0 < near < far:
            raise InvalidInput(f"distances of {near:g} to {far:g} m: write NEAR:FAR, both positive")
        reach = focal * (PairOptions.baseline if given.baseline is None else given.baseline)
        doffs = given.doffs or PairOptions.doffs
        return reach / far - doffs, reach / near - doffs
    if given.disparities is not None:
        return given.disparities
    least, greatest = DEFAULT_DISPARITIES
    return least * width, greatest * width


@writes
def simulate_pairs(options: SimulateOptions, progress: Progress = SILENT) -> StereoReport:
    """Return the pairs after writing images, disparities, what both cameras see, and the cameras into options.output.

    Raises InvalidInput if the folder holds something else or so many pairs are not made, FileError if it cannot be
    written.
    """
    pair, count, folder = pair_options(options), options.pairs.count, options.output
    if not 1 <= count <= MAX_PAIRS:
        raise InvalidInput(f"{count} pairs: use 1 to {MAX_PAIRS}")
    simulate.require_own(folder, RIG)
    with owned(folder):
        claim([folder / RIG, *(path for index in range(count) for path in _files_of(folder, index))])
        for path in _left_over(folder, count):
            path.unlink()
        native.write(folder / RIG, rig_file(options, pair))
        work = partial(_make, folder, pair, options.seed)
        made = fan_out(work, range(count), jobs=options.jobs, processes=True, what="rendering", progress=progress)
        outcomes = list(made)
    require_all(outcomes, "pairs")
    pairs = tuple(outcome.value for outcome in outcomes if outcome.value is not None)
    return StereoReport(folder / RIG, pair.size, of_pair(*pair.cameras()), pairs)


def _left_over(folder: Path, count: int) -> Iterator[Path]:
    """Yield the files of an earlier run that this one does not replace."""
    kept = {_name(index) for index in range(count)}
    for kind in FOLDERS:
        for path in (folder / kind).glob("[0-9][0-9][0-9].*"):
            if path.name.partition(".")[0] not in kept:
                yield path


def _name(index: int) -> str:
    return f"{index:03d}"


def _files_of(folder: Path, index: int) -> list[Path]:
    """Return the files of a pair but for sidecars: left, right, both disparities, what both see."""
    suffixes = (".png", ".png", ".pfm", ".pfm", ".png")
    return [folder / kind / f"{_name(index)}{suffix}" for kind, suffix in zip(FOLDERS, suffixes, strict=True)]


def _make(folder: Path, options: PairOptions, seed: int, index: int) -> PairFiles:
    # A generator of its own for every pair, so that the images do not depend on who renders them.
    truth = render_pair(options, np.random.default_rng([seed, index]))
    left, right, disparity_left, disparity_right, visible = _files_of(folder, index)
    pair = PairFiles(
        left=left,
        right=right,
        disparity=disparity_left,
        disparity_right=disparity_right,
        visible=visible,
        least=float(np.nanmin(truth.disparity_left)),
        greatest=float(np.nanmax(truth.disparity_left)),
        shared=float(truth.visible.mean()),
    )
    _write(pair, truth)
    return pair


def _write(pair: PairFiles, truth: StereoTruth) -> None:
    save(pair.left, truth.left)
    save(pair.right, truth.right)
    save(pair.visible, np.where(truth.visible, 255, 0).astype(np.uint8))
    geometry = of_pair(truth.left_camera, truth.right_camera, truth.right_T_left)
    _write_disparity(pair.disparity, truth.disparity_left, pair.left, geometry)
    seen_from_right = replace(geometry, cx=geometry.cx + geometry.doffs)
    _write_disparity(pair.disparity_right, truth.disparity_right, pair.right, seen_from_right)


def _write_disparity(path: Path, values: Array, image: Path, geometry: StereoGeometry) -> None:
    written = disparity.write(path, values)
    disparity_sidecar.write(path, Sidecar(written.scale, written.invalid, geometry, image))


def rig_file(options: SimulateOptions, pair: PairOptions) -> CameraFile:
    """Return the camera file of the pairs: both cameras, the way between them, and how the images were made."""
    left, right, right_T_left = pair.cameras()
    how = {"pairs": options.pairs.count, "seed": options.seed, "stereo": asdict(pair)}
    return CameraFile(
        {name: CameraEntry(camera, valid=ValidRegion.of(camera)) for name, camera in ((LEFT, left), (RIGHT, right))},
        transforms={"right_T_left": Transform(right_T_left)},
        provenance=provenance.build(command_line("simulate", options), None),
        extra={simulate.MARK: how},
    )


def document(report: StereoReport, options: SimulateOptions) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "output": options.output,
        "rig": report.rig,
        "image_size": report.size,
        "geometry": report.geometry,
        "pairs": report.pairs,
    }
