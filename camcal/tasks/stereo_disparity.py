"""`camcal stereo disparity`: rectified pairs to disparity maps, and how far to believe them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats import disparity as maps
from camcal.formats import disparity_sidecar
from camcal.formats.disparity import Written
from camcal.formats.disparity_sidecar import Sidecar, SourceFile
from camcal.images.load import load
from camcal.images.save import save
from camcal.progress import SILENT, Outcome, Progress
from camcal.raw.planes import one_by_one
from camcal.report.disparity_pictures import disparity_picture, robust_range
from camcal.run.fanout import fan_out, over_threads
from camcal.run.inputs import record_outputs
from camcal.run.outputs import place, refuse_overwriting
from camcal.run.pairs import find_pairs
from camcal.stereo.disparity import Confidence, Disparity
from camcal.stereo.learned import learned_disparity
from camcal.stereo.match import BEST, MatchOptions, match_prepared
from camcal.stereo.preparation import prepare
from camcal.tasks.rectified_pair import GeometryOptions, RectifiedPair, pair_of

TYPES = tuple(suffix[1:] for suffix in maps.SUFFIXES)
OWN, ONNX = "own", "onnx"
ENGINES = (OWN, ONNX)

_KINDS = ("sigma.tiff", "confidence.png", "vis.png")  # of what stands beside a map
_AT_THE_END = 0.01  # share of the pixels in the last pixel of the range that is no chance

Pair = tuple[Path, Path]
Limits = tuple[float, float]


@dataclass(frozen=True)
class DisparityOptions:
    """Pairs (files, folders, patterns of either side), where their maps go, and how they are matched.

    output: a file for a single pair, otherwise a folder. camera_file: of the rectified pair, FILE or FILE#NAME.
    type: of the files in a folder. model: the network of the engine onnx. picture: draw each map. map_only: write no
    uncertainty and no classes beside it.
    """

    left: Sequence[Path | str]
    right: Sequence[Path | str]
    output: Path
    camera_file: str | None = None
    geometry: GeometryOptions = field(default_factory=GeometryOptions)
    matching: MatchOptions = field(default_factory=MatchOptions)
    model: Path | None = None
    type: str = "tiff"
    picture: bool = False
    map_only: bool = False
    recursive: bool = False
    jobs: int | None = None

    def __post_init__(self) -> None:
        if self.type not in TYPES:
            raise InvalidInput(f"type {self.type!r} is unknown; use one of {', '.join(TYPES)}")


def network_of(engine: str, model: Path | None) -> Path | None:
    """Return the network that matches, None for camcal's own matchers; raises InvalidInput if one is missing."""
    if engine not in ENGINES:
        raise InvalidInput(f"engine {engine!r} is unknown; use one of {', '.join(ENGINES)}")
    if (engine == ONNX) != (model is not None):
        raise InvalidInput("--engine onnx and --model FILE go together")
    return model


class _Files(NamedTuple):
    """What is written of one pair."""

    map: Path
    sigma: Path
    confidence: Path
    picture: Path
    sidecar: Path

    @classmethod
    def beside(cls, path: Path) -> "_Files":
        sigma, confidence, picture = (path.with_name(f"{path.stem}.{kind}") for kind in _KINDS)
        return cls(path, sigma, confidence, picture, disparity_sidecar.path_beside(path))


@dataclass(frozen=True)
class Figures:
    """A map in numbers.

    size: (width, height), pixels. searched: smallest and largest disparity looked for, pixels. matched: share of the
    pixels that are matched and not filled. filled: share that is. classes: share of each `Confidence`. median: of the
    disparities, pixels, None without any. sigma: median of their standard deviations, pixels, None if unknown.
    """

    size: tuple[int, int]
    searched: tuple[int, int]
    matched: float
    filled: float
    classes: Mapping[str, float]
    median: float | None
    sigma: float | None

    @classmethod
    def of(cls, disparity: Disparity) -> "Figures":
        height, width = disparity.values.shape
        shares = np.bincount(disparity.confidence.ravel(), minlength=len(Confidence)) / disparity.values.size
        return cls(
            size=(width, height),
            searched=disparity.searched,
            matched=float(shares[Confidence.SINGLE :].sum()),
            filled=float(shares[Confidence.FILLED]),
            classes={each.name.lower(): float(shares[each]) for each in Confidence},
            median=_median(disparity.values),
            sigma=_median(disparity.sigma),
        )


def _median(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None


@dataclass(frozen=True)
class MatchedPair:
    """A pair and its map.

    rows: by which the right image was aligned, px RMS. scale: counts of the file per pixel of disparity. limits: of
    the colours of a picture. geometry_known: whether the sidecar holds it.
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
    remarks: tuple[str, ...]


def stereo_disparity(options: DisparityOptions, progress: Progress = SILENT) -> list[Outcome[Pair, MatchedPair]]:
    """Return what became of every pair, in natural order; one that fails costs only itself.

    Raises InvalidInput and FileError for inputs that are no pairs and outputs that would replace them, and whatever
    kept a single pair from being matched.
    """
    pairs = find_pairs(options.left, options.right, options.recursive)
    outputs = _places(pairs, options)
    work = partial(_match_files, options=options, outputs=outputs)
    if len(pairs) == 1:
        return [Outcome(pairs[0], _warned(work(pairs[0], alone=True), progress))]
    outcomes = list(_all_alike(pairs, work, options, progress))
    record_outputs(options.output, [name for outcome in outcomes if outcome.value for name in _names(outcome.value)])
    return outcomes


def _all_alike(
    pairs: Sequence[Pair], work: "partial[MatchedPair]", options: DisparityOptions, progress: Progress
) -> Iterator[Outcome[Pair, MatchedPair]]:
    """Yield what becomes of several pairs, whose pictures have the colours of the first one's."""
    if options.picture:
        for outcome in fan_out(work, pairs[:1]):
            if outcome.value is not None:
                work = partial(work, limits=outcome.value.limits)
    for outcome in fan_out(work, pairs, jobs=options.jobs, processes=True, what="disparity", progress=progress):
        if outcome.value is not None:
            _warned(outcome.value, progress)
        yield outcome


def _places(pairs: Sequence[Pair], options: DisparityOptions) -> Mapping[Path, Path]:
    outputs = place([left for left, _ in pairs], options.output, f".{options.type}", maps.SUFFIXES)
    inputs = [path for pair in pairs for path in pair]
    for output in outputs.values():
        written = _Files.beside(output)
        refuse_overwriting(written, inputs)
        disparity_sidecar.require_own(written.sidecar)
    return outputs


def _match_files(
    pair: Pair,
    options: DisparityOptions,
    outputs: Mapping[Path, Path],
    limits: Limits | None = None,
    *,
    alone: bool = False,
) -> MatchedPair:
    left, right = (load(path).pixels for path in pair)
    written = _Files.beside(outputs[pair[0]])
    try:
        size = left.shape[1], left.shape[0]
        known = pair_of(options.geometry, options.camera_file, size)
        found = _by_network(left, right, options.model) if options.model else _matched(left, right, options, alone)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=error.where or f"{pair[0]} and {pair[1]}") from error
    return _written(pair, found, known, written, options, limits)


class _Matched(NamedTuple):
    """A map, by how much the rows were aligned (px RMS), and what there is to say of it."""

    disparity: Disparity
    rows: float
    remarks: tuple[str, ...]


def _matched(left: Array, right: Array, options: DisparityOptions, alone: bool) -> _Matched:
    matching = options.matching
    prepared = prepare(left, right, matching.search, align=matching.aligns, expose=matching.expose_alike)
    if alone and matching.quality == BEST:
        with over_threads(options.jobs) as each:
            disparity = match_prepared(prepared, matching, each)
    else:
        disparity = match_prepared(prepared, matching, one_by_one)
    return _Matched(disparity, prepared.rows, prepared.remarks)


def _by_network(left: Array, right: Array, model: Path) -> _Matched:
    values = learned_disparity(left, right, model)
    known = np.isfinite(values)
    confidence = np.where(known, Confidence.SINGLE, Confidence.NONE)
    ends = (int(np.floor(values[known].min())), int(np.ceil(values[known].max()))) if known.any() else (0, 0)
    return _Matched(Disparity(values, np.full_like(values, np.nan), confidence, ends), 0.0, ())


def _written(
    pair: Pair,
    found: _Matched,
    known: RectifiedPair,
    places: _Files,
    options: DisparityOptions,
    limits: Limits | None,
) -> MatchedPair:
    """Return the report of a pair whose files have been written."""
    disparity = found.disparity
    stored, remarks = _write_map(places.map, disparity, found.remarks)
    has_sigma = bool(np.isfinite(disparity.sigma).any()) and not options.map_only
    if has_sigma:
        maps.write(places.sigma, disparity.sigma)
    if not options.map_only:
        save(places.confidence, disparity.confidence)
    limits = limits or robust_range(disparity.values)
    if options.picture:
        save(places.picture, disparity_picture(disparity.values, limits, known.geometry))
    sidecar = Sidecar(
        stored.scale,
        stored.invalid,
        known.geometry,
        pair[0],
        places.sigma if has_sigma else None,
        None if options.map_only else places.confidence,
        disparity.searched,
        _settings(options) | {"rows_px": found.rows},
        {name: SourceFile(path, files.sha256(path)) for name, path in zip(("left", "right"), pair, strict=True)},
        relative_sigma=known.relative_sigma,
    )
    disparity_sidecar.write(places.map, sidecar)
    return MatchedPair(
        *pair,
        output=places.map,
        figures=Figures.of(disparity),
        rows=found.rows,
        scale=stored.scale,
        picture=places.picture if options.picture else None,
        limits=limits,
        geometry_known=known.geometry is not None,
        remarks=remarks,
    )


def _write_map(path: Path, disparity: Disparity, remarks: tuple[str, ...]) -> tuple[Written, tuple[str, ...]]:
    """Return how a map was written, and the remarks with what is to be said of that."""
    values = disparity.values
    remarks += _at_the_ends(disparity)
    if path.suffix.lower() == ".png" and (values <= 0).any():
        remarks += (f"{np.sum(values <= 0)} disparities of 0 or less are left out of a PNG; a TIFF holds them",)
        values = np.where(values > 0, values, np.float32(np.nan))
    stored = maps.write(path, values)
    return stored, remarks + ((stored.remark,) if stored.remark else ())


def _at_the_ends(disparity: Disparity) -> tuple[str, ...]:
    """Return a remark if more disparities lie at an end of the range than chance puts there."""
    values = disparity.values[disparity.confidence > Confidence.FILLED]
    if not values.size:
        return ("nothing is matched; do both images show the same scene, and is the range right?",)
    first, last = disparity.searched
    crowded = [
        f"{share:.1%} of the disparities lie at the {end} end of the range {first}:{last}; look farther with --range"
        for end, share in (("lower", np.mean(values < first + 1)), ("upper", np.mean(values > last - 1)))
        if share > _AT_THE_END
    ]
    return tuple(crowded)


def _settings(options: DisparityOptions) -> dict[str, Any]:
    if options.model is not None:
        return {"engine": ONNX, "model": options.model.name}
    return {"engine": OWN, "quality": options.matching.quality, "fill": options.matching.fill}


def _warned(matched: MatchedPair, progress: Progress) -> MatchedPair:
    for remark in matched.remarks:
        progress.warn(f"{matched.left}: {remark}")
    return matched


def _names(matched: MatchedPair) -> list[str]:
    return [path.name for path in _Files.beside(matched.output)]


def document(outcomes: Sequence[Outcome[Pair, MatchedPair]]) -> dict[str, Any]:
    """Return what became of the pairs as plain data for --json."""
    matched = [outcome.value for outcome in outcomes if outcome.value is not None]
    return {
        "pairs": [_plain(pair) for pair in matched],
        "failed": [
            {"left": left.as_posix(), "right": right.as_posix(), "message": str(outcome.error)}
            for outcome in outcomes
            if outcome.error is not None
            for left, right in (outcome.item,)
        ],
    }


def _plain(pair: MatchedPair) -> dict[str, Any]:
    figures = pair.figures
    return {
        "left": pair.left.as_posix(),
        "right": pair.right.as_posix(),
        "output": pair.output.as_posix(),
        "sidecar": disparity_sidecar.path_beside(pair.output).as_posix(),
        "picture": None if pair.picture is None else pair.picture.as_posix(),
        "image_size": list(figures.size),
        "searched": list(figures.searched),
        "matched": figures.matched,
        "filled": figures.filled,
        "classes": dict(figures.classes),
        "median_px": figures.median,
        "sigma_px": figures.sigma,
        "rows_px": pair.rows,
        "scale": pair.scale,
        "geometry": pair.geometry_known,
        "remarks": list(pair.remarks),
    }
