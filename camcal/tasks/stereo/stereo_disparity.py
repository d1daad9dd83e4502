"""`camcal stereo disparity`: rectified pairs to disparity maps with their files, figures and uncertainty."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal import records
from camcal.arrays import Array, PixelArray
from camcal.dataclass import dataclass, field, replace
from camcal.errors import FileError, GateFailed, InvalidInput
from camcal.formats import disparity as maps
from camcal.formats import disparity_sidecar
from camcal.formats.disparity_sidecar import Sidecar, SourceFile
from camcal.images.files import load, save
from camcal.messages import Message
from camcal.progress import SILENT, Outcome, Progress, failed_items, reused, warn_of
from camcal.records import entry
from camcal.report.stereo_pictures import disparity_picture, robust_range
from camcal.run import fingerprint
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_pairs, place
from camcal.run.resume import Items, resumable
from camcal.stereo.disparity import Confidence, Disparity
from camcal.tasks.stereo.options import ONNX, OWN, DisparityOptions
from camcal.tasks.stereo.rectified_pair import pair_of, warn_of_file
from camcal.tasks.stereo.rig_pair import Matched, PairImages, RigPair, match_images, read_pair, unrectified_pair

_KINDS = ("sigma.tiff", "confidence.png", "vis.png", "left.png")

Pair = tuple[Path, Path]
Limits = tuple[float, float]
_AT_THE_END = 0.02  # share of the matches in the last pixel of the range that is no chance


class MapFiles(NamedTuple):
    """What is written of one pair, each named by the map: x.pfm, x.pfm.sigma.tiff and so on."""

    map: Path
    sigma: Path
    confidence: Path
    picture: Path
    left: Path
    sidecar: Path

    @classmethod
    def beside(cls, path: Path) -> "MapFiles":
        sigma, confidence, picture, left = (path.with_name(f"{path.name}.{kind}") for kind in _KINDS)
        return cls(path, sigma, confidence, picture, left, disparity_sidecar.path_beside(path))


@dataclass(frozen=True)
class Figures:
    """A map in numbers.

    size: (width, height), pixels. searched: smallest and largest disparity searched for, pixels. at_ends: shares of the
    matches that lie at either of them. matched: share of those that are matched and not filled. filled:
    share that is. classes: share of each `Confidence`. median: of the disparities, pixels, None without any. sigma:
    median of their standard deviations, pixels, None if unknown.
    """

    size: tuple[int, int] = field(metadata=entry("image_size"))
    searched: tuple[int, int]
    at_ends: tuple[float, float]
    matched: float
    filled: float
    classes: Mapping[str, float]
    median: float | None = field(metadata=entry("median_px"))
    sigma: float | None = field(metadata=entry("sigma_px"))

    @classmethod
    def of(cls, disparity: Disparity, pixels: int) -> "Figures":
        """Return the figures of a map; pixels: how many show something, which the shares are of."""
        height, width = disparity.values.shape
        counts = np.bincount(disparity.confidence.ravel(), minlength=len(Confidence))
        counts[Confidence.NONE] -= disparity.values.size - pixels
        shares = counts / max(pixels, 1)
        return cls(
            size=(width, height),
            searched=disparity.searched,
            at_ends=disparity.at_ends,
            matched=float(shares[Confidence.SINGLE :].sum()),
            filled=float(shares[Confidence.FILLED]),
            classes={each.name.lower(): float(shares[each]) for each in Confidence},
            median=_median(disparity.values),
            sigma=_median(disparity.sigma),
        )


@dataclass(frozen=True)
class MatchedPair:
    """A pair and its map.

    rows: by which the right image was aligned, px RMS. scale: counts of the file per pixel of disparity. limits: of
    the colours of a picture. geometry_known: whether the sidecar holds it. warnings: of the range and of the
    file. failures: why the pair or its map cannot be used.
    """

    left: Path
    right: Path
    output: Path
    figures: Figures
    rows: float
    scale: float
    picture: Path | None
    limits: Limits
    geometry_known: bool
    warnings: tuple[Message, ...]
    failures: tuple[Message, ...]


@writes
def stereo_disparity(options: DisparityOptions, progress: Progress = SILENT) -> list[Outcome[Pair, MatchedPair]]:
    """Return what became of every pair, in natural order; one that fails costs only itself.

    Raises InvalidInput and FileError for inputs that are no pairs and outputs that would replace them, and whatever
    kept a single pair from being matched.
    """
    pairs = find_pairs(options.left, options.right, options.recursive)
    outputs = place([left for left, _ in pairs], options.output, f".{options.type}", maps.SUFFIXES)
    claim(path for output in outputs.values() for path in MapFiles.beside(output))
    warn_of_file(options.camera_file, progress)
    batch = _Batch(options, outputs, _rig(pairs, options, progress))
    found = []
    for outcome in batch.alone(pairs) if len(pairs) == 1 else batch.all_alike(pairs, progress):
        if outcome.value is not None:
            warn_of((warning.at(outcome.value.left) for warning in outcome.value.warnings), progress)
        found.append(outcome)
    return found


def _rig(pairs: Sequence[Pair], options: DisparityOptions, progress: Progress) -> RigPair | None:
    """Return the cameras that the pairs are to be rectified by, None if they are rectified."""
    if options.geometry.numbers():
        return None
    given = options.geometry
    rig = unrectified_pair(options.camera_file, given.camera, lambda: load(pairs[0][0]).size, given.given.part)
    if rig is not None:
        warn_of(rig.rectification.warnings, progress)
    return rig


def require_good(outcomes: Sequence[Outcome[Pair, MatchedPair]]) -> None:
    """Raise GateFailed with the failures of all pairs; their files are written."""
    found = failures(outcomes)
    if found:
        raise GateFailed.of(found)


def failures(outcomes: Sequence[Outcome[Pair, MatchedPair]]) -> list[Message]:
    """Return why pairs or their maps cannot be used."""
    matched = [outcome.value for outcome in outcomes if outcome.value is not None]
    return [failure.at(pair.left) for pair in matched for failure in pair.failures]


@dataclass(frozen=True, eq=False)
class _Batch:
    """What all pairs share: the options, the map of each pair by its left image, and the rig of unrectified pairs."""

    options: DisparityOptions
    outputs: Mapping[Path, Path]
    rig: RigPair | None

    def alone(self, pairs: Sequence[Pair]) -> Iterator[Outcome[Pair, MatchedPair]]:
        """Yield what becomes of a single pair, on all cores; raises what keeps it from being matched."""
        work = partial(self.work(None), alone=True)
        return resumable(work, pairs, self.items(None), batch=self.options.batch, alone=True)

    def all_alike(self, pairs: Sequence[Pair], progress: Progress) -> Iterator[Outcome[Pair, MatchedPair]]:
        """Yield what becomes of several pairs, whose pictures have the colours of the first one's."""
        jobs, batch, limits = self.options.jobs, self.options.batch, None
        if self.options.picture:
            [first] = resumable(self.work(None), pairs[:1], self.items(None), batch=batch.keep_going)
            yield first
            if first.error is not None and batch.fail_fast:
                return
            limits, pairs = None if first.value is None else first.value.limits, pairs[1:]
        yield from resumable(
            self.work(limits),
            pairs,
            self.items(limits),
            jobs=jobs,
            batch=batch,
            processes=True,
            what="disparity",
            progress=progress,
        )

    def work(self, limits: Limits | None) -> "partial[MatchedPair]":
        """Return what is done with a pair; limits: of the colours of its picture, None for its own."""
        return partial(_match_files, options=self.options, outputs=self.outputs, rig=self.rig, limits=limits)

    def items(self, limits: Limits | None) -> Items[Pair, MatchedPair]:
        """Return what maps are made from, and their files."""
        settings = fingerprint.of_settings(self.options, without=("left", "right", "recursive"))
        written = partial(_written, outputs=self.outputs)
        return Items(fingerprint.of_data([settings, limits]), _inputs, written, MatchedPair)


def _inputs(pair: Pair) -> list[Path | str]:
    """Return the images of a pair and their names, which the sidecar of the map holds."""
    return [*pair, *(path.as_posix() for path in pair)]


def _written(pair: Pair, outputs: Mapping[Path, Path]) -> MapFiles:
    return MapFiles.beside(outputs[pair[0]])


def _match_files(
    pair: Pair,
    options: DisparityOptions,
    outputs: Mapping[Path, Path],
    rig: RigPair | None = None,
    limits: Limits | None = None,
    *,
    alone: bool = False,
) -> MatchedPair:
    written = MapFiles.beside(outputs[pair[0]])
    images = read_pair(pair, rig, partial(pair_of, options.geometry, options.camera_file))
    try:
        found = match_images(images, options.matching, options.model, options.jobs if alone else 1)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=error.where or f"{pair[0]} and {pair[1]}") from error
    return write_map(images, found, written, options, limits)


def write_map(
    images: PairImages,
    found: Matched,
    places: MapFiles,
    options: DisparityOptions,
    limits: Limits | None,
) -> MatchedPair:
    """Return the report of a pair whose files have been written, the map and its sidecar last."""
    known = images.known
    disparity, warnings = _as_stored(places.map, found)
    _remove_companions(places)
    has_sigma = bool(np.isfinite(disparity.sigma).any()) and not options.map_only
    if has_sigma:
        maps.write(places.sigma, disparity.sigma)
    if not options.map_only:
        save(places.confidence, disparity.confidence)
    if images.image is None:
        save(places.left, for_png(images.left))
    limits = limits or robust_range(disparity.values)
    if options.picture:
        save(places.picture, disparity_picture(disparity.values, limits, known.geometry))
    stored = maps.write(places.map, disparity.values)
    sidecar = Sidecar(
        stored.scale,
        stored.invalid,
        geometry=known.geometry,
        image=images.image or places.left,
        sigma=places.sigma if has_sigma else None,
        confidence=None if options.map_only else places.confidence,
        searched=disparity.searched,
        matcher=_settings(options) | {"rows_px": found.rows},
        inputs={
            name: SourceFile(path, fingerprint.of_source(path))
            for name, path in zip(("left", "right"), images.paths, strict=True)
        },
        camera_R_rectified=known.camera_R_rectified,
        relative_sigma=known.relative_sigma,
        calibration=known.calibration,
    )
    disparity_sidecar.write(places.map, sidecar)
    return MatchedPair(
        *images.paths,
        output=places.map,
        figures=Figures.of(disparity, found.pixels),
        rows=found.rows,
        scale=stored.scale,
        picture=places.picture if options.picture else None,
        limits=limits,
        geometry_known=known.geometry is not None,
        warnings=warnings + stored.warnings,
        failures=found.failures,
    )


def for_png(pixels: PixelArray) -> PixelArray:
    """Return an image as a PNG can hold it: floating point, 0 … 1, as 16 bits."""
    if pixels.dtype != np.float32:
        return pixels
    return np.rint(np.clip(np.nan_to_num(pixels), 0, 1) * np.iinfo(np.uint16).max).astype(np.uint16)


def _remove_companions(places: MapFiles) -> None:
    """Remove what an earlier run left beside the map: the sidecar first, for it would tell of the map to come."""
    for path in (places.sidecar, places.sigma, places.confidence, places.picture, places.left):
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise FileError(f"cannot be replaced: {error.strerror}", where=str(path)) from error


def _as_stored(path: Path, found: Matched) -> tuple[Disparity, tuple[Message, ...]]:
    """Return the map as the type of file can hold it, and its warnings."""
    disparity, warnings = found.disparity, found.warnings + _at_the_ends(found.disparity)
    behind = disparity.values <= 0
    if path.suffix.lower() == ".png" and behind.any():
        text = f"{behind.sum()} disparities of 0 or less omitted: a PNG cannot store them, a TIFF can"
        warnings += (Message("omitted_disparities", text, {"pixels": int(behind.sum())}),)
        nothing = np.float32(np.nan)
        values, sigma = (np.where(behind, nothing, each) for each in (disparity.values, disparity.sigma))
        disparity = replace(disparity, values=values, sigma=sigma, confidence=disparity.confidence * ~behind)
    return disparity, warnings


def _at_the_ends(disparity: Disparity) -> tuple[Message, ...]:
    """Return a warning if more of the best matches lie at an end of the range than chance puts there."""
    first, last = disparity.searched
    return tuple(
        Message(
            "range_too_narrow",
            f"{share:.1%} of the matches at the {end} end of the range {first}:{last}: widen --range",
            {"share": share},
        )
        for end, share in zip(("lower", "upper"), disparity.at_ends, strict=True)
        if share > _AT_THE_END
    )


def _settings(options: DisparityOptions) -> dict[str, Any]:
    if options.model is not None:
        return {"engine": ONNX, "model": options.model.name}
    return {"engine": OWN, "quality": options.matching.quality, "fill": options.matching.fill}


def document(outcomes: Sequence[Outcome[Pair, MatchedPair]]) -> dict[str, Any]:
    """Return what became of the pairs as plain data for --json."""
    matched = [outcome.value for outcome in outcomes if outcome.value is not None]
    return {
        "pairs": [_plain(pair) for pair in matched],
        "reused": reused(outcomes),
        "failures": failures(outcomes),
        "failed": failed_items(outcomes, "left", "right"),
    }


def _plain(pair: MatchedPair) -> dict[str, Any]:
    return {
        "left": pair.left,
        "right": pair.right,
        "output": pair.output,
        "sidecar": disparity_sidecar.path_beside(pair.output),
        "picture": pair.picture,
        **records.document(pair.figures),
        "rows_px": pair.rows,
        "scale": pair.scale,
        "geometry": pair.geometry_known,
    }


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None
