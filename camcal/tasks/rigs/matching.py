"""Which images of several cameras were taken together: by their names, their index or their times."""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from camcal.calibrate.rigs.record import Captures
from camcal.errors import InvalidInput
from camcal.files import natural_key
from camcal.messages import counted
from camcal.run.paths import NAME_READINGS
from camcal.targets.detection import BoardDetection
from camcal.tasks.rigs.camera_inputs import varying
from camcal.tasks.rigs.options import AUTO, INDEX, NAME, TIME

Views = Mapping[str, Sequence[BoardDetection]]  # of every camera, in the order of its images
Paths = Mapping[str, Sequence[Path]]
Keys = Mapping[str, Sequence[Hashable]]

_ENOUGH = 0.5  # of the images of the camera with fewest: so many names agree, or they are no common names
_NAMED = 3  # images in a message


@dataclass(frozen=True, eq=False)
class Matched:
    """Captures, how their images were found to belong together, and the images without a partner.

    largest: the largest time difference within a capture, s, None where times do not count.
    """

    captures: Captures
    by: str
    unmatched: tuple[str, ...] = ()
    largest: float | None = None

    @property
    def line(self) -> str:
        """The line of the report."""
        several = sum(sum(view is not None for view in row) > 1 for row in self.captures.views)
        apart = "" if self.largest is None else f", largest time difference {1e3 * self.largest:.3g} ms"
        alone = f"; {counted(len(self.unmatched), 'image')} unmatched" if self.unmatched else ""
        return (
            f"{counted(several, 'capture')} of {len(self.captures.cameras)} cameras, matched by {self.by}{apart}{alone}"
        )


def matched(views: Views, match: str = AUTO, tolerance: float | None = None) -> Matched:
    """Return the captures that images of two or more cameras make.

    match: by name, index or time, or whichever of them tells. tolerance: s, None for half of the shortest interval.
    Raises InvalidInput where nothing tells which images belong together.
    """
    timed = all(view.time is not None for own in views.values() for view in own)
    if match == TIME and not timed:
        image = next(view.image for own in views.values() for view in own if view.time is None)
        raise InvalidInput("has no time: set --timestamps, or --match name or index", where=image)
    if match == TIME or (match == AUTO and timed):
        return _by_time(views, tolerance)
    if match in (AUTO, NAME):
        found = _by_name(views)
        least = 1 if match == NAME else _ENOUGH * min(map(len, views.values()))
        if found is not None and len(found.captures) and _shared(found) >= least:
            return found
        if match == NAME:
            raise InvalidInput(f"no two cameras have images of one name: {_counts(views)}; use --match index or time")
    if match == AUTO and len(set(map(len, views.values()))) > 1:
        raise InvalidInput(
            f"the names of the images have too little in common, and their counts differ: {_counts(views)}; rename "
            "them, or use --match index or time"
        )
    keys = {name: range(1, len(own) + 1) for name, own in views.items()}
    return _collect(views, keys, INDEX, str)


def _counts(views: Views) -> str:
    return ", ".join(f"{name} {len(own)} ({own[0].image} …)" if own else f"{name} 0" for name, own in views.items())


def _shared(found: Matched) -> int:
    """Return the number of captures of two cameras or more."""
    return sum(sum(view is not None for view in row) > 1 for row in found.captures.views)


def _by_name(views: Views) -> Matched | None:
    """Return the captures by the reading of the names under which most images have a partner, None if none has."""
    best: tuple[int, Keys] | None = None
    stems = {name: [Path(view.image) for view in own] for name, own in views.items()}
    for reading in (_each(NAME_READINGS[0]), _without_camera, _varying, *map(_each, NAME_READINGS[1:])):
        keys = reading(stems)
        if any(len(set(own)) < len(own) for own in keys.values()):
            continue
        counts = Counter(key for own in keys.values() for key in own)
        count = sum(counts[key] > 1 for own in keys.values() for key in own)
        if count > (best[0] if best else 0):
            best = count, keys
    if best is None:
        return None
    return _collect(views, best[1], NAME, _words)


def _each(reading: Callable[[Path], str]) -> Callable[[Paths], Keys]:
    return lambda paths: {name: [reading(path) for path in own] for name, own in paths.items()}


def _without_camera(paths: Paths) -> Keys:
    """Return the names of images without that of the camera: left01 of left, cam0_01 of cam0."""
    return {name: [path.stem.replace(name, "", 1).strip("_-. ") for path in own] for name, own in paths.items()}


def _varying(paths: Paths) -> Keys:
    """Return what differs between the names of any camera's images."""
    found = varying([[path.stem for path in own] for own in paths.values()])
    return {name: list(own) for name, own in zip(paths, found, strict=True)}


def _words(key: Hashable) -> str:
    return "_".join(map(str, key)) if isinstance(key, tuple) else str(key)


def _by_time(views: Views, tolerance: float | None) -> Matched:
    """Return the captures of images that were taken within the tolerance, each of another camera.

    In the order of time, an image belongs to the capture before it if it is of a camera that this lacks and within the
    tolerance of its first image; with less than half of an interval, that is the nearest one.
    """
    times = {name: np.array([float(view.time or 0.0) for view in own]) for name, own in views.items()}
    limit = _usual_tolerance(times) if tolerance is None else tolerance
    events = sorted((time, name, place) for name, own in times.items() for place, time in enumerate(own.tolist()))
    keys: dict[str, list[Hashable]] = {name: [None] * len(own) for name, own in views.items()}
    start, members = -np.inf, set(views)
    largest = 0.0
    for time, name, place in events:
        if name in members or time - start > limit:
            start, members = time, set()
        members.add(name)
        largest = max(largest, time - start)
        keys[name][place] = start
    found = _collect(views, keys, TIME, lambda key: f"{key:.6f}".rstrip("0").rstrip("."))
    if not _shared(found):
        raise InvalidInput(
            f"no two cameras have images within {1e3 * limit:.3g} ms: their clocks differ, or --time-tolerance is too "
            "small"
        )
    return replace(found, largest=largest)


def _usual_tolerance(times: Mapping[str, np.ndarray]) -> float:
    """Return half of the shortest of the cameras' usual intervals, s."""
    steps = [float(np.median(np.diff(np.sort(own)))) for own in times.values() if len(own) > 1]
    return 0.5 * min(steps, default=0.0)


def _collect(views: Views, keys: Keys, by: str, words: Callable[..., str]) -> Matched:
    """Return the captures of views by their keys, in the natural order of these."""
    cameras = tuple(views)
    rows: dict[Hashable, dict[str, BoardDetection]] = {}
    for name in cameras:
        for key, view in zip(keys[name], views[name], strict=True):
            rows.setdefault(key, {})[name] = view
    rows = dict(sorted(rows.items(), key=lambda row: natural_key(words(row[0]))))
    alone = [row for row in rows.values() if len(row) == 1]
    captures = Captures(
        cameras,
        _distinct(words(key) or next(iter(row.values())).image for key, row in rows.items()),
        tuple(tuple(row.get(name) for name in cameras) for row in rows.values()),
    )
    return Matched(captures, by, tuple(view.image for row in alone for view in row.values()))


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Return names, a number behind those that another one has already."""
    taken: Counter[str] = Counter()
    result = []
    for name in names:
        taken[name] += 1
        result.append(name if taken[name] == 1 else f"{name} ({taken[name]})")
    return tuple(result)


def unmatched_words(images: Sequence[str]) -> str:
    """Return which images have no partner, the first of them by name."""
    named = ", ".join(Path(image).name for image in images[:_NAMED])
    more = f" and {len(images) - _NAMED} more" if len(images) > _NAMED else ""
    return f"{counted(len(images), 'image')} without a partner of another camera: {named}{more}"
