"""Flat and dark frames grouped into exposure levels by folder, exposure and brightness."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from camcal.errors import InsufficientData, InvalidInput
from camcal.images.image import RAW_SUFFIXES
from camcal.progress import Progress, values_of
from camcal.raw.options import HEADERLESS_SUFFIXES
from camcal.run.fanout import fan_out
from camcal.run.paths import find_images
from camcal.tasks.raw.options import RawInput
from camcal.tasks.raw.raw_corrections import read_frame

_EXPOSURE = re.compile(r"(?:^|[_ -])([0-9]+(?:\.[0-9]+)?) ?(us|ms|s)(?:$|[_ -])", re.IGNORECASE)
_ISO = re.compile(r"(?:^|[_ -])iso ?([0-9]+)(?:$|[_ -])", re.IGNORECASE)
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0}
_STEP = 0.03  # of the light: frames that differ by more are of another level
_SMALLEST_STEP = 0.1  # counts: nearly dark frames differ by chance


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
    seen = [item for place, one in enumerate(inputs) for item in _named(one, _given(exposures, place))]
    unread = [item for item in seen if item.exposure_s is None or item.paths[0].suffix.lower() in RAW_SUFFIXES]
    if unread:
        work = partial(_read, reading=reading)
        seen = values_of(fan_out(work, seen, jobs=jobs, what="looking at frames", progress=progress))
    sets = [part for group in _grouped(seen) for part in ([group] if black is None else _by_brightness(group, black))]
    return [_as_set(part) for part in sets]


def _given(exposures: Sequence[float], place: int) -> float | None:
    return exposures[place if len(exposures) > 1 else 0] if exposures else None


def _named(one: Path | str, exposure_s: float | None) -> list[FrameSet]:
    """Return the files of an input, each by itself, with what their folders' names tell."""
    found = []
    for path in find_images([one], recursive=True, also=HEADERLESS_SUFFIXES):
        exposure, iso = _EXPOSURE.search(path.parent.name), _ISO.search(path.parent.name)
        named = float(exposure[1]) * _SECONDS[exposure[2].lower()] if exposure else None
        found.append(FrameSet((path,), named if exposure_s is None else exposure_s, float(iso[1]) if iso else None))
    return found


def _read(item: FrameSet, reading: RawInput) -> FrameSet:
    """Return a single file with what it says itself, and its mean."""
    frame = read_frame(item.paths[0], reading)
    exposure = frame.capture.exposure_s if item.exposure_s is None else item.exposure_s
    iso = frame.capture.iso if item.iso is None else item.iso
    return FrameSet(item.paths, exposure, iso, float(frame.values.mean()))


def _grouped(seen: Sequence[FrameSet]) -> list[list[FrameSet]]:
    groups: dict[tuple[Path, float | None, float | None], list[FrameSet]] = {}
    for item in seen:
        groups.setdefault((item.paths[0].parent, item.exposure_s, item.iso), []).append(item)
    return list(groups.values())


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
