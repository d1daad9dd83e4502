"""Flat and dark frames of a simulated raw camera, and what its truth says of the sensor."""

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal.cameras.model import Camera
from camcal.formats.camera_file import CameraEntry, ValidRegion
from camcal.images.files import save
from camcal.progress import Progress, require_all
from camcal.run.fanout import fan_out
from camcal.simulate.mosaics import FixedPattern, RawCamera, Shot, even_frame, exposure_series, lenses
from camcal.tasks.simulation.options import RawOptions

FLATS, DARKS = "flats", "darks"
FRAMES_A_LEVEL = 2
_DARK_EXPOSURES = (0.01, 0.1)  # without flat frames to be subtracted from
_FEW_DARKS = 4  # that few are taken at one exposure: two frames are needed to tell noise from pattern
_FLAT_STREAM, _DARK_STREAM, _PATTERN_STREAM = 1, 2, 3


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
