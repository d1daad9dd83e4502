"""`camcal sensor`: characterisation of a sensor from flat and dark frames.

Frames are grouped into exposure levels by folder, exposure and brightness.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import fields
from functools import partial
from math import ceil, log2
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput, Located
from camcal.formats import emit, provenance
from camcal.images.image import RAW_SUFFIXES
from camcal.messages import Message
from camcal.optics import pixel_pitch, sensor_format
from camcal.options import command_line
from camcal.progress import SILENT, Progress, values_of, warn_of
from camcal.raw.emva import DECIBELS_A_STOP, FULL_WELL, Characterisation, Curve, Figure, Figures, characterise
from camcal.raw.frame_facts import Widened, likely_white, low_peak, used_counts, widened
from camcal.raw.level import Level, measure_level
from camcal.raw.mosaic import Mosaic
from camcal.raw.options import HEADERLESS_SUFFIXES
from camcal.report.figures.curves import characterisation, sensor_plots
from camcal.report.figures.figure import encoded
from camcal.report.table import value_and_std
from camcal.run.fanout import fan_out
from camcal.run.outputs import writes
from camcal.run.paths import find_images
from camcal.tasks.figure_files import figure_data, write_figures
from camcal.tasks.fit_report import SENSOR
from camcal.tasks.raw.demosaic import read_frame
from camcal.tasks.raw.options import RawInput, SensorOptions

_EXPOSURE = re.compile(r"(?:^|[_ -])([0-9]+(?:\.[0-9]+)?) ?(us|ms|s)(?:$|[_ -])", re.IGNORECASE)
_ISO = re.compile(r"(?:^|[_ -])iso ?([0-9]+)(?:$|[_ -])", re.IGNORECASE)
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0}
_STEP = 0.03  # of the light: frames that differ by more are of another level
_SMALLEST_STEP = 0.1  # counts: nearly dark frames differ by chance
VERSION = 1
COMMENT = "camcal sensor file. DN: counts, e: electrons. The block `sensor` goes into a camera file as it is."
_WORDS = {
    "gain_dn_per_e": ("gain", 1.0, "DN/e"),
    "read_noise_e": ("read noise", 1.0, "e"),
    "full_well_e": ("full well", 1.0, "e"),
    "dynamic_range_db": ("dynamic range", 1.0, "dB"),
    "threshold_e": ("absolute sensitivity threshold", 1.0, "e"),
    "emva_dynamic_range_db": ("dynamic range (EMVA 1288)", 1.0, "dB"),
    "snr_max_db": ("SNRmax", 1.0, "dB"),
    "black_dn": ("black level", 1.0, "DN"),
    "dsnu_e": ("DSNU", 1.0, "e"),
    "prnu": ("PRNU", 100.0, "%"),
    "linearity_error": ("linearity error", 100.0, "%"),
    "dark_current_e_s": ("dark current", 1.0, "e/s"),
}


@dataclass(frozen=True)
class FrameSet:
    """Frames of one level of light: files; seconds, ISO speed and mean counts as far as they are known."""

    paths: tuple[Path, ...]
    exposure_s: float | None
    iso: float | None = None
    mean: float | None = None

    @property
    def where(self) -> str:
        return f"{self.paths[0]} …" if len(self.paths) > 1 else str(self.paths[0])


def find_sets(
    inputs: Sequence[Path | str],
    exposures: Sequence[float],
    reading: RawInput,
    *,
    black: float | None = None,
    jobs: int | None,
    progress: Progress,
) -> list[FrameSet]:
    """Return the levels of the frames that files, folders and patterns stand for.

    exposures: seconds, one for all inputs or one for each; they come before what folders (10ms, iso400_0.5s) and files
    say. black: counts without light, None if these are the dark frames. Frames of another folder or exposure are of
    another level, and so are flat frames that differ by 3 % in brightness.
    Raises InsufficientData for a level of a single frame, InvalidInput for another number of exposures.
    """
    if len(exposures) not in (0, 1, len(inputs)):
        raise InvalidInput(f"{len(exposures)} exposures for {len(inputs)} inputs: give one, or one for each")
    given: list[float | None] = [*exposures] or [None]
    seconds = given * len(inputs) if len(given) == 1 else given
    items = [item for one, exposure in zip(inputs, seconds, strict=True) for item in _files_of(one, exposure)]
    unread = [item for item in items if item.exposure_s is None or item.paths[0].suffix.lower() in RAW_SUFFIXES]
    if unread:
        work = partial(_read, reading=reading)
        items = values_of(fan_out(work, items, jobs=jobs, what="looking at frames", progress=progress))
    groups: dict[tuple[Path, float | None, float | None], list[FrameSet]] = {}
    for item in items:
        groups.setdefault((item.paths[0].parent, item.exposure_s, item.iso), []).append(item)
    sets = [part for group in groups.values() for part in ([group] if black is None else _by_brightness(group, black))]
    return [_as_set(part) for part in sets]


def _files_of(one: Path | str, exposure_s: float | None) -> list[FrameSet]:
    """Return the files of an input, each by itself, with what their folders' names tell."""
    files = []
    for path in find_images([one], recursive=True, also=HEADERLESS_SUFFIXES):
        exposure, iso = _EXPOSURE.search(path.parent.name), _ISO.search(path.parent.name)
        named = float(exposure[1]) * _SECONDS[exposure[2].lower()] if exposure else None
        files.append(FrameSet((path,), named if exposure_s is None else exposure_s, float(iso[1]) if iso else None))
    return files


def _read(item: FrameSet, reading: RawInput) -> FrameSet:
    """Return a single file with what it says itself, and its mean."""
    frame = read_frame(item.paths[0], reading)
    exposure = frame.capture.exposure_s if item.exposure_s is None else item.exposure_s
    iso = frame.capture.iso if item.iso is None else item.iso
    return FrameSet(item.paths, exposure, iso, float(frame.values.mean()))


def _by_brightness(group: list[FrameSet], black: float) -> list[list[FrameSet]]:
    """Return the frames of a group as sets of the same light, darkest first; all in one where they were not read."""
    means = [item.mean for item in group if item.mean is not None]
    if len(means) < len(group):
        return [group]
    order = np.argsort(means, kind="stable")
    light = np.array(means)[order] - black
    steps = np.diff(light) > np.maximum(_STEP * light[:-1], _SMALLEST_STEP)
    return [[group[place] for place in sorted(part)] for part in np.split(order, np.flatnonzero(steps) + 1)]


def _as_set(part: Sequence[FrameSet]) -> FrameSet:
    first = part[0]
    if len(part) < 2:
        told = "" if first.exposure_s is None else f" at {1e3 * first.exposure_s:g} ms"
        raise InsufficientData(
            f"single frame{told}: every level needs at least two frames of the same exposure",
            where=first.where,
        )
    return replace(first, paths=tuple(item.paths[0] for item in part))


@dataclass(frozen=True, eq=False)
class SensorReport:
    """What was found, from which frames; pitch: metres, None if unknown; the warnings; the files of figures."""

    sensor: Characterisation
    flats: tuple[FrameSet, ...]
    darks: tuple[FrameSet, ...]
    iso: float | None
    pitch: float | None
    warnings: tuple[Message, ...]
    figures: tuple[Path, ...] = ()


@writes
def sensor(options: SensorOptions, progress: Progress = SILENT) -> SensorReport:
    """Return what a sensor can do, after writing it to options.output and, if asked for, a figure.

    Raises InvalidInput for frames that do not go together or an output that is one of them, InsufficientData for too
    few or saturated ones, FileError for a file that cannot be read or written.
    """
    if options.sensor_format is not None:
        sensor_format(options.sensor_format)
    darks = _sets(options, progress)
    dark_means = [one.mean for one in darks if one.mean is not None]
    flats = _sets(options, progress, black=min(dark_means, default=0.0))
    iso, flats, darks = _at_one_speed(flats, darks, options.iso)
    of_light, of_darkness = ({path for one in sets for path in one.paths} for sets in (flats, darks))
    if both := of_light & of_darkness:
        raise InvalidInput("is both a flat and a dark frame", where=str(min(both)))
    look = partial(_used_counts, reading=options.reading)
    firsts = [one.paths[0] for one in (*flats, *darks)]
    spread = widened(values_of(fan_out(look, firsts, jobs=options.jobs, what="looking at counts", progress=progress)))
    work = partial(_measure, reading=options.reading, white=options.white, spread=spread)
    characterised = characterise(
        *(
            values_of(fan_out(work, sets, jobs=options.jobs, what="measuring frames", progress=progress))
            for sets in (flats, darks)
        )
    )
    warnings = (*_counts_warnings(characterised, spread, options), *characterised.warnings)
    name = options.sensor_format
    pitch = options.pitch if name is None else pixel_pitch(sensor_format(name), characterised.size)
    report = SensorReport(characterised, tuple(flats), tuple(darks), iso, pitch, warnings)
    if options.plot is not None:
        files.write_bytes(options.plot, encoded(characterisation(characterised), options.plot.suffix))
    files.write_text(options.output, emit.document(_file(report, options), COMMENT))
    warn_of(warnings, progress)
    return replace(report, figures=write_figures(options.figures, sensor_plots(characterised)))


def _sets(options: SensorOptions, progress: Progress, black: float | None = None) -> list[FrameSet]:
    inputs, exposures = (options.darks, options.dark_exposures) if black is None else (options.flats, options.exposures)
    return find_sets(inputs, exposures, options.reading, black=black, jobs=options.jobs, progress=progress)


def _at_one_speed(
    flats: list[FrameSet], darks: list[FrameSet], wanted: float | None
) -> tuple[float | None, list[FrameSet], list[FrameSet]]:
    """Return the ISO speed and the frames taken at it; frames that do not say theirs are taken to have it.

    Raises InvalidInput if there are several speeds and none is chosen, or none of the chosen one.
    """
    speeds = sorted({one.iso for one in (*flats, *darks) if one.iso is not None})
    listed = ", ".join(f"{speed:g}" for speed in speeds)
    if wanted is None and len(speeds) > 1:
        raise InvalidInput(f"frames of ISO {listed}: choose one with --iso")
    iso = wanted if wanted is not None else next(iter(speeds), None)
    kept = [[one for one in sets if one.iso in (None, iso)] for sets in (flats, darks)]
    for sets, kind in zip(kept, ("flat", "dark"), strict=True):
        if not sets:
            raise InvalidInput(f"no {kind} frames of ISO {iso:g}; there are ISO {listed}")
    return iso, kept[0], kept[1]


def _used_counts(path: Path, reading: RawInput) -> Array:
    return used_counts(read_frame(path, reading))


def _measure(one: FrameSet, reading: RawInput, white: float | None, spread: Widened | None) -> Level:
    """Return the statistics of a level in the counts of the sensor: rounding noise is that of one of them."""
    frames: Iterator[Mosaic] = (read_frame(path, reading) for path in one.paths)
    if spread is not None:
        step, sensor_white = spread.step, spread.white
        frames = (
            replace(frame, values=np.rint(frame.values / step).astype(np.uint16), white=sensor_white)
            for frame in frames
        )
        if white is not None and white > sensor_white:  # meant in the counts of the file
            white /= step
    with Located(one.where):
        return measure_level(frames, one.exposure_s, white)


def _counts_warnings(found: Characterisation, spread: Widened | None, options: SensorOptions) -> Iterator[Message]:
    if spread is not None:
        text = (
            f"{spread.bits}-bit counts scaled by {spread.step:g}: figures are in sensor counts, 0 to {spread.white:g}"
        )
        yield Message("scaled_counts", text, {"bits": spread.bits, "factor": spread.step})
    likely = None if options.white is not None else likely_white(found.peak, found.white)
    # Pixels that are full before the counts end need no white level.
    if likely is not None and (found.saturation != FULL_WELL or found.peak == likely):
        yield low_peak(found.peak, found.white, likely)


def sensor_block(report: SensorReport) -> dict[str, Any]:
    """Return the block `sensor` of a camera file."""
    figures, white = report.sensor.figures, report.sensor.white
    return {
        "pixel_pitch_um": None if report.pitch is None else 1e6 * report.pitch,
        "gain_e_per_dn": 1 / figures.gain_dn_per_e.value,
        "read_noise_e": figures.read_noise_e.value,
        "full_well_e": figures.full_well_e.value,
        "black_level_dn": max(figures.black_dn.value, 0.0),
        # A file of 16 bits may hold fewer: then the largest one is never seen.
        "bits": ceil(log2(white + 1)) if report.sensor.peak > white / 2 else None,
    }


def _file(report: SensorReport, options: SensorOptions) -> dict[str, Any]:
    sensor = report.sensor
    images = [{"file": path.as_posix()} for one in (*report.flats, *report.darks) for path in one.paths]
    return {
        "format": SENSOR,
        "version": VERSION,
        **_content(report),
        "warnings": list(map(str, report.warnings)),
        "curves": {name: _curve(curve) for name, curve in sensor.curves.items()},
        "provenance": provenance.build(command_line("sensor", options), None, images),
    }


def document(report: SensorReport, options: SensorOptions) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    plot = {} if options.plot is None else {"plot": options.plot.as_posix()}
    return {"output": options.output.as_posix(), **plot, **_content(report), **figure_data(report.figures)}


def _content(report: SensorReport) -> dict[str, Any]:
    sensor = report.sensor
    return {
        "image_size": list(sensor.size),
        "iso": report.iso,
        "levels": {"flat": len(report.flats), "dark": len(report.darks)},
        "sensor": {key: value for key, value in sensor_block(report).items() if value is not None},
        "saturation": sensor.saturation,
        "rounding_limited": sensor.limited,
        "figures": _numbers(sensor.figures),
        "dynamic_range_stops": sensor.dynamic_range_stops,
        "phases": {name: _numbers(part) for name, part in sensor.phases.items()},
    }


def _numbers(part: Figures) -> dict[str, Any]:
    return {name: {"value": figure.value, "std": figure.std} for name, figure in figures_by_name(part).items()}


def figures_by_name(part: Figures) -> dict[str, Figure]:
    """Return the figures that were measured."""
    named = {field.name: getattr(part, field.name) for field in fields(Figures)}
    return {name: figure for name, figure in named.items() if figure is not None}


def rows(part: Figures) -> list[list[Any]]:
    """Return name, value, standard deviation and unit of every figure in the units that people use."""
    table: list[list[Any]] = []
    for name, figure in figures_by_name(part).items():
        words, factor, unit = _WORDS[name]
        table.append([words, *value_and_std(factor * figure.value, factor * figure.std), unit])
        if name == "dynamic_range_db":
            table.append(["", *value_and_std(figure.value / DECIBELS_A_STOP, figure.std / DECIBELS_A_STOP), "stops"])
    return table


def _curve(curve: Curve) -> dict[str, Any]:
    timed = bool(np.isfinite(curve.exposure_s).all())
    return {
        "exposure_s": curve.exposure_s.tolist() if timed else None,
        "signal_dn": curve.signal.tolist(),
        "variance_dn2": curve.variance.tolist(),
        "fitted": curve.fitted.tolist(),
    }
