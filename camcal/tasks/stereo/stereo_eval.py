"""`camcal stereo eval`: disparity maps against ground truth, with quality gates.

There is one map and one truth, or folders of both.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import FileError, InvalidInput
from camcal.formats import disparity
from camcal.formats.disparity import DisparityMap, maps_in
from camcal.formats.disparity_sidecar import Sidecar
from camcal.images.files import load, save
from camcal.messages import Message
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Collected, Outcome, Progress, failed_items, warn_of
from camcal.report.stereo_pictures import error_picture
from camcal.run.fanout import fan_out, only_outcome
from camcal.run.outputs import claim, writes
from camcal.run.paths import paired, place, require_there
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.truth import (
    AT_LEAST,
    FIGURES,
    Evaluation,
    evaluate,
    mean_of,
    unoccluded,
    visible_in_both,
)
from camcal.tasks.figure_files import figure_data, write_figures
from camcal.tasks.stereo.options import EvalOptions, TruthPair
from camcal.tasks.stereo.rectified_pair import geometry_of, named_file, warn_of_file

if TYPE_CHECKING:
    from camcal.report.figures.figure import Plot

PICTURES = (".png", ".jpg", ".jpeg", ".tiff", ".tif", ".bmp")

_SEEN = 255  # in Middlebury's masks; 128 is occluded
_LIKELY_SCALES = (2.0, 3.0, 4.0, 8.0, 16.0, 256.0)
_ALIKE = 0.05  # of the ratio of medians, for a scale to be the likely one
_SAMPLES = 1 << 16


@dataclass(frozen=True)
class PairReport:
    """What one map is worth: how it and its truth were scaled, what tells the occluded pixels, the picture."""

    files: TruthPair
    evaluation: Evaluation
    scale: float
    truth_scale: float
    occlusion: str
    geometry: StereoGeometry | None
    picture: Path | None
    warnings: tuple[Message, ...]


@dataclass(frozen=True)
class DisparityVerdict:
    """A gate as it was given, the figure it is about, and whether it holds."""

    gate: str
    value: float
    passed: bool


@dataclass(frozen=True)
class EvalReport:
    """What became of every pair, their mean (of a single one: its own figures), the gates on that, and figure files."""

    outcomes: Sequence[Outcome[TruthPair, PairReport]]
    mean: Evaluation
    verdicts: tuple[DisparityVerdict, ...] = ()
    figures: tuple[Path, ...] = ()

    @property
    def failures(self) -> list[Message]:
        """The gates that do not hold."""
        return [
            Message("eval_gate", f"{each.gate} failed: {each.value:.4g}", {"value": each.value})
            for each in self.verdicts
            if not each.passed
        ]

    @property
    def pairs(self) -> list[PairReport]:
        return [outcome.value for outcome in self.outcomes if outcome.value is not None]


class Gate(NamedTuple):
    """A figure, its column (None: the first that has it), and the largest, of density the smallest, value allowed."""

    text: str
    name: str
    column: str | None
    limit: float


@writes
def stereo_eval(options: EvalOptions, progress: Progress = SILENT) -> EvalReport:
    """Return the errors of all maps. A map of several that cannot be evaluated costs only itself.

    Raises InvalidInput for gates that name no figure, files that do not fit together or an incomplete geometry,
    FileError, InsufficientData if no pixel has a truth; if all of several maps fail, the first error.
    """
    gates = [read_gate(text) for text in options.gates]
    pairs = truth_pairs(options.files)
    pictures = _pictures(pairs, options.output)
    warn_of_file(options.camera_file, progress)
    outcomes = _outcomes(pairs, pictures, options, progress)
    done = [outcome.value for outcome in outcomes if outcome.value is not None]
    if not done:
        raise next(outcome.error for outcome in outcomes if outcome.error is not None)
    for report in done:
        warn_of(report.warnings, progress)
    mean = mean_of([report.evaluation for report in done])
    for report in done:
        if unknown := _unknown(report.evaluation, mean):
            text = f"{unknown}; excluded from their mean"
            progress.warn(Message("unknown_figures", text, where=str(report.files.disparity)))
    verdicts = tuple(_verdict(gate, mean) for gate in gates)
    return EvalReport(outcomes, mean, verdicts, _write_figures(done, options))


def _write_figures(reports: Sequence[PairReport], options: EvalOptions) -> tuple[Path, ...]:
    """Write the figures of all maps, of several under their names; the maps are read once more, one after another."""
    if options.figures.folder is None:
        return ()
    from camcal.report.figures.disparity_errors import ERROR_PLOTS
    from camcal.report.figures.figure import name_of_part

    names = list(ERROR_PLOTS)
    if len(reports) > 1:
        names = [name_of_part(name, report.files.disparity.stem) for report in reports for name in ERROR_PLOTS]
    return write_figures(options.figures, _plots(reports, options), names=names)


def _plots(reports: Sequence[PairReport], options: EvalOptions) -> Iterator["Plot"]:
    from camcal.report.figures.disparity_errors import DisparityErrors, disparity_error_plots
    from camcal.report.figures.figure import of_part

    for report in reports:
        values = disparity.read(report.files.disparity, options.scale).matched()
        true = disparity.read(report.files.truth, options.truth_scale).matched()
        own = disparity_error_plots(
            DisparityErrors(values - true, np.isfinite(true), _visible(report.files, options, true)[0])
        )
        yield from own if len(reports) == 1 else of_part(own, report.files.disparity.stem)


def _unknown(evaluation: Evaluation, mean: Evaluation) -> str | None:
    """Return which figures are not known of one map, while they are of others; None if there are none."""
    gaps = [
        (name, column)
        for column, figures in mean.figures.items()
        for name, value in figures.items()
        if np.isnan(evaluation.figures[column][name]) and not np.isnan(value)
    ]
    if not gaps:
        return None
    names, columns = (", ".join(dict.fromkeys(words)) for words in zip(*gaps, strict=True))
    return f"no {names} in {columns}"


def _pictures(pairs: Sequence[TruthPair], output: Path | None) -> dict[Path, Path]:
    if output is None:
        return {}
    pictures = place([pair.disparity for pair in pairs], output, ".png", PICTURES)
    claim(pictures.values())
    return pictures


def _outcomes(
    pairs: Sequence[TruthPair], pictures: Mapping[Path, Path], options: EvalOptions, progress: Progress
) -> list[Outcome[TruthPair, PairReport]]:
    """Return what becomes of every pair; raises the error of a single one."""
    work = partial(_evaluate_pair, options=options)
    items = [_Item(pair.disparity, pair, pictures.get(pair.disparity)) for pair in pairs]
    if len(items) == 1:
        found = iter([only_outcome(work, items[0], options.batch)])
    else:
        found = fan_out(work, items, jobs=options.jobs, batch=options.batch, what="evaluate", progress=progress)
    return [Outcome(outcome.item.pair, outcome.value, outcome.error) for outcome in found]


class _Item(NamedTuple):
    """A map, what it is compared with, and the picture that is drawn of it."""

    map: Path
    pair: TruthPair
    picture: Path | None


def _evaluate_pair(item: _Item, options: EvalOptions) -> PairReport:
    files, picture = item.pair, item.picture
    found = disparity.read(files.disparity, options.scale)
    truth = disparity.read(files.truth, options.truth_scale)
    geometry = _geometry(options, found, (found.sidecar, truth.sidecar))
    values, true = found.matched(), truth.matched()
    visible, occlusion = _visible(files, options, true)
    heard = Collected()
    sigma, confidence = _predicted(files, found.sidecar, truth.scale, heard)
    try:
        evaluation = evaluate(values, true, visible, geometry, sigma, confidence)
    except InvalidInput as error:
        raise InvalidInput(error.message, where=str(files.disparity)) from error
    if picture is not None:
        save(picture, error_picture(np.abs(values - true), np.isfinite(true), visible))
    return PairReport(
        files,
        evaluation,
        scale=found.scale,
        truth_scale=truth.scale,
        occlusion=occlusion,
        geometry=geometry,
        picture=picture,
        warnings=(*heard.warnings, *_likely_scale(values, true, files)),
    )


def _geometry(options: EvalOptions, found: DisparityMap, sidecars: Iterable[Sidecar | None]) -> StereoGeometry | None:
    """Return the geometry that numbers, a camera file or a sidecar give, in this order; None without any."""
    height, width = found.values.shape
    sidecar = next((known for known in sidecars if known and known.geometry), None)
    given = options.geometry
    if options.camera_file is None and sidecar is None and given.numbers():
        given = replace(given, cx=0.0, cy=0.0)  # the depth does not ask for them
    return geometry_of(given, options.camera_file, (width, height), sidecar)


def _visible(files: TruthPair, options: EvalOptions, truth: Array) -> tuple[Array, str]:
    """Return the mask of what both cameras see (H, W), and where it is from."""
    if files.mask is not None and files.right_truth is not None:
        raise InvalidInput("--mask and --right-truth exclude each other")
    if files.mask is not None:
        return _read_mask(files.mask), f"mask {files.mask.name}"
    if files.right_truth is not None:
        right = disparity.read(files.right_truth, options.truth_scale).matched()
        return visible_in_both(truth, right), "left-right check of the truths"
    return unoccluded(truth), "the truth warped to the right image"


def _read_mask(path: Path) -> Array:
    """Return where a mask says that both cameras see: 255 of 8 bits, what is not 0 of 16 (KITTI's disp_noc)."""
    pixels = load(path).pixels
    if pixels.ndim == 3:
        pixels = pixels[:, :, 0]
    if pixels.dtype not in (np.uint8, np.uint16):
        raise FileError(f"a mask has 8 or 16 bits, found {pixels.dtype}", where=str(path))
    return np.asarray(pixels == _SEEN if pixels.dtype == np.uint8 else pixels > 0)


def _predicted(
    files: TruthPair, sidecar: Sidecar | None, truth_scale: float, progress: Progress
) -> tuple[Array | None, Array | None]:
    """Return sigma and confidence of every pixel, from the files named or those that the sidecar names.

    truth_scale: counts of the truth per pixel. Rounding to them is an error of the truth, which sigma has to allow for.
    """
    known = sidecar or Sidecar()
    sigma = files.sigma or named_file(known.sigma, files.disparity, progress)
    confidence = files.confidence or named_file(known.confidence, files.disparity, progress)
    rounding = 1 / (np.sqrt(12) * truth_scale) if truth_scale > 1 else 0.0  # a truth in whole pixels has a scale of 1,
    return (  # and so have all in floating point: neither says how exact it is
        np.hypot(disparity.read(sigma).matched(), np.float32(rounding)) if sigma else None,
        load(confidence).pixels if confidence else None,
    )


def _likely_scale(values: Array, truth: Array, files: TruthPair) -> tuple[Message, ...]:
    """Return a warning if one map looks as if its numbers were still counts: they are 4, 8, … times the other's."""
    both = (values > 0) & (truth > 0) & np.isfinite(values) & np.isfinite(truth)
    pairs = values[both][:: max(1, both.sum() // _SAMPLES)], truth[both][:: max(1, both.sum() // _SAMPLES)]
    if not pairs[0].size:
        return ()
    ratio = float(np.median(pairs[1] / pairs[0]))
    for option, times, path in (("--truth-scale", ratio, files.truth), ("--scale", 1 / ratio, files.disparity)):
        for scale in _LIKELY_SCALES:
            if abs(times / scale - 1) < _ALIKE:
                text = f"disparities are {scale:g} times those of the other map: try {option} {scale:g}"
                return (Message("likely_scale", text, {"scale": scale}, str(path)),)
    return ()


def read_gate(text: str) -> Gate:
    """Return a gate written as FIGURE=LIMIT or FIGURE:COLUMN=LIMIT; raises InvalidInput for anything else."""
    address, _, limit = text.partition("=")
    name, _, column = address.partition(":")
    if name not in FIGURES:
        raise InvalidInput(f"unknown figure {name!r}{did_you_mean(name, FIGURES)}", where=f"--gate {text}")
    try:
        bound = float(limit)
    except ValueError:
        bound = np.nan
    if not np.isfinite(bound):
        raise InvalidInput("a gate is written FIGURE=LIMIT or FIGURE:COLUMN=LIMIT", where=f"--gate {text}")
    return Gate(text, name, column or None, bound)


def _verdict(gate: Gate, evaluation: Evaluation) -> DisparityVerdict:
    columns = [gate.column] if gate.column else list(evaluation.figures)
    value = next((evaluation.figures.get(column, {})[gate.name] for column in columns
                  if gate.name in evaluation.figures.get(column, {})), None)  # fmt: skip
    if value is None:
        there = [column for column, figures in evaluation.figures.items() if gate.name in figures]
        advice = f"available in {', '.join(there)}" if there else "unknown here (no geometry, no sigma)"
        raise InvalidInput(f"no {gate.name} in {gate.column or 'any column'}; {advice}", where=f"--gate {gate.text}")
    passed = value >= gate.limit if gate.name in AT_LEAST else value <= gate.limit
    return DisparityVerdict(gate.text, value, passed)


def document(report: EvalReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        "pairs": [_pair_document(pair) for pair in report.pairs],
        "mean": _figures(report.mean),
        "gates": report.verdicts,
        "failed": failed_items([outcome.of(outcome.item.disparity) for outcome in report.outcomes], "disparity"),
        **figure_data(report.figures),
    }


def _pair_document(pair: PairReport) -> dict[str, Any]:
    curve = pair.evaluation.sparsification
    return {
        **pair.files.files,
        "scale": pair.scale,
        "truth_scale": pair.truth_scale,
        "occlusion": pair.occlusion,
        "geometry": pair.geometry,
        "picture": pair.picture,
        **_figures(pair.evaluation),
        "sparsification": {"by_sigma": curve.by_sigma, "by_error": curve.by_error} if curve else None,
    }


def _figures(evaluation: Evaluation) -> dict[str, Any]:
    return {"pixels": evaluation.pixels, "figures": evaluation.figures, "classes": evaluation.classes}


def truth_pairs(given: TruthPair) -> list[TruthPair]:
    """Return the pairs that files or folders stand for; the files of folders belong together as `paired` says.

    Raises InvalidInput if files and folders are mixed or the files of folders differ, FileError for what is
    not there or empty.
    """
    for path in given.files.values():
        require_there(path)
    folders = {name: path.is_dir() for name, path in given.files.items()}
    if not any(folders.values()):
        return [given]
    if not all(folders.values()):
        file = next(path for name, path in given.files.items() if not folders[name])
        raise InvalidInput("is not a folder: give only files or only folders", where=str(file))
    maps = maps_in(given.disparity)
    partners = {
        name: dict(paired(maps, maps_in(folder), (f"maps in {given.disparity}", f"files in {folder}")))
        for name, folder in given.files.items()
    }
    return [TruthPair(**{name: files[path] for name, files in partners.items()}) for path in maps]
