"""`camcal stereo run`: (calibrate →) rectify → check → disparity → cloud → view, for all pairs of two cameras."""

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from camcal import messages
from camcal.errors import GateFailed, InvalidInput, ItemsFailed
from camcal.formats import native
from camcal.formats.native import untrustworthy
from camcal.images import video
from camcal.images.load import load
from camcal.messages import Message
from camcal.options import command_line
from camcal.progress import SILENT, Outcome, Progress, reused, warn_of
from camcal.report import stereo_words
from camcal.run import fingerprint
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_media, find_pairs, place
from camcal.run.resume import Items, resumable
from camcal.stereo.rectify.record import Rectification
from camcal.tasks.rigs.calibrate_rig import RigReport, calibrated
from camcal.tasks.rigs.rig_views import rig_views
from camcal.tasks.stereo.rig_pair import GivenRig, RigPair, read_rig, rectified_file, rig_pair
from camcal.tasks.stereo.run_options import RunOptions
from camcal.tasks.stereo.run_pair import Capture, PairRun, RunFiles, RunPair

RIG, RECTIFIED = "rig.yaml", "rectified.yaml"

_LARGE = 4_000_000  # pixels; of larger pairs one at a time is matched, for the memory that each takes


@dataclass(frozen=True, eq=False)
class RunReport:
    """What became of every pair, the rig file and how the images were rectified.

    calibration: None with a rig given. doubts: why the calibration must not be trusted, by itself or by the rig file.
    """

    rig_file: Path
    rectified_file: Path
    rectification: Rectification
    outcomes: Sequence[Outcome[Capture, RunPair]]
    calibration: RigReport | None = None
    doubts: Sequence[Message] = ()

    @property
    def pairs(self) -> list[RunPair]:
        """The pairs that were run."""
        return [outcome.value for outcome in self.outcomes if outcome.value is not None]

    @property
    def failures(self) -> list[Message]:
        """Why pairs or their maps cannot be used."""
        return [failure.at(pair.capture.left) for pair in self.pairs for failure in pair.failures]


@writes
def stereo_run(options: RunOptions, progress: Progress = SILENT) -> RunReport:
    """Return what became of every pair after writing to the folder options.output; one that fails costs only itself.

    Raises InvalidInput and FileError for inputs that are no pairs or no rig, what kept the cameras from being
    calibrated or rectified, and the first pair's error when none could be run.
    """
    scene = _Scene.of(options)
    folder = options.output
    rectified = folder / RECTIFIED
    outputs = [path for name in scene.names for path in RunFiles.of(folder, name, options.clouds).every()]
    claim([*outputs, rectified, *([] if options.rig else [folder / RIG])])
    calibration = None if options.rig else _calibrated(options, folder / RIG, progress)
    address = options.rig or str(folder / RIG)
    # what is said of a file made here, its calibration has said already
    rig = read_rig(address, options.cameras, scene.size, progress=SILENT if calibration else progress)
    rectification = rig.rectification(options.view)
    warn_of((each.at(address) for each in rectification.warnings), progress)
    outcomes = list(_outcomes(scene, rig_pair(rig, rectification), rig.path, options, progress))
    done = [outcome.value for outcome in outcomes if outcome.value is not None]
    if not done:
        raise next(outcome.error for outcome in outcomes if outcome.error is not None)
    native.write(rectified, rectified_file(rig, rectification, command_line("stereo run", options)))
    for pair in done:
        warn_of((warning.at(pair.capture.left) for warning in pair.warnings), progress)
    report = RunReport(rig.path, rectified, rectification, outcomes, calibration, _doubts(rig, calibration))
    if options.force:
        warn_of(report.failures, progress)
    return report


def _doubts(rig: GivenRig, calibration: RigReport | None) -> list[Message]:
    """Return why the calibration must not be trusted; of a rig file that was given, what it says itself."""
    if calibration is not None:
        return [each.at(rig.path) for each in calibration.failures]
    entries = {f"{rig.path}#{name}": rig.file.cameras[name] for name in rig.names}
    return [each for where, entry in entries.items() for each in untrustworthy(entry, where)]


def require_good(report: RunReport, options: RunOptions) -> None:
    """Raise GateFailed for a calibration that is not as required, or with the failures of all pairs; ItemsFailed for
    pairs that could not be run. Files are written. With options.force failures of pairs are warnings.
    """
    required = options.settings.require
    if required and report.doubts:
        raise GateFailed.of(report.doubts, where=f"--require {required}")
    if report.failures and not options.force:
        raise GateFailed.of(report.failures)
    failed = [outcome for outcome in report.outcomes if outcome.error is not None]
    if failed:
        raise ItemsFailed.of(len(failed), len(report.outcomes), "pairs")


def _calibrated(options: RunOptions, path: Path, progress: Progress) -> RigReport:
    settings = replace(
        options.settings, output=path, recursive=options.recursive, jobs=options.jobs, batch=options.batch
    )
    inputs = [f"{name}={images}" for name, images in zip(("left", "right"), options.inputs, strict=True)]
    command = command_line("stereo run", options)
    return calibrated(lambda: rig_views(inputs, settings, progress), settings, command, progress)


def _outcomes(
    scene: "_Scene", rig: RigPair, rig_file: Path, options: RunOptions, progress: Progress
) -> Iterator[Outcome[Capture, RunPair]]:
    """Yield what becomes of the pairs in their order: small ones in processes, large ones by threads for each."""
    width, height = rig.rectification.size
    alone = len(scene.names) == 1 or width * height > _LARGE
    run = PairRun(rig, options, options.jobs if alone else 1)
    settings = fingerprint.of_settings(options, without=("inputs", "scene", "every", "recursive"))
    facts = [settings, fingerprint.of_file(rig_file), scene.size()]
    written = partial(_written, options=options)
    pairs: Items[Capture, RunPair] = Items(fingerprint.of_data(facts), _inputs, written, RunPair, _named)
    with closing(scene.captures()) as frames:
        yield from resumable(
            run,
            frames if scene.videos else list(frames),
            pairs,
            jobs=1 if alone else options.jobs,
            batch=options.batch,
            processes=not alone,
            what="stereo run",
            progress=progress,
        )


def _inputs(capture: Capture) -> list[Path | str]:
    """Return what a pair is: its images, or the frames of its videos, and the names that its files hold."""
    names = [path.as_posix() for path in _named(capture)]
    if capture.frames is None:
        return [*_named(capture), *names]
    return [*map(fingerprint.of_array, capture.frames), *names]


def _named(capture: Capture) -> tuple[Path, Path]:
    return capture.left, capture.right


def _written(capture: Capture, options: RunOptions) -> list[Path]:
    return list(RunFiles.of(options.output, capture.name, options.clouds).every())


@dataclass(frozen=True, eq=False)
class _Scene:
    """The pairs of a scene: of images, or of the frames of two videos.

    names: of their outputs; of videos as many as the shorter one has frames.
    """

    pairs: Sequence[tuple[Path, Path]]
    names: Sequence[str]
    videos: tuple[Path, Path] | None = None
    every: int = 1

    @classmethod
    def of(cls, options: RunOptions) -> "_Scene":
        """Return the scene that the options name. Raises InvalidInput and FileError for inputs that are no pairs."""
        left, right = (find_media([text], options.recursive) for text in options.pairs)
        if left.videos or right.videos:
            if left.images or right.images or len(left.videos) != 1 or len(right.videos) != 1:
                raise InvalidInput("a video of one camera goes with one video of the other", where=options.pairs[0])
            pair = left.videos[0], right.videos[0]
            count = min(_count(path) for path in pair)
            names = [video.frame_name(pair[0], index) for index in range(0, count, options.every)]
            return cls([], [Path(name).name for name in names], pair, options.every)
        pairs = find_pairs([options.pairs[0]], [options.pairs[1]], options.recursive)[:: options.every]
        outputs = place([first for first, _ in pairs], options.output, "", ())
        return cls(pairs, [path.name for path in outputs.values()])

    def size(self) -> tuple[int, int]:
        """Return width and height of the left images."""
        frame = next(iter(video.frames(self.videos[0]))).pixels if self.videos else load(self.pairs[0][0]).pixels
        return frame.shape[1], frame.shape[0]

    def captures(self) -> Generator[Capture]:
        """Yield the pairs in their order; the frames of videos as they are decoded."""
        if self.videos is None:
            for (left, right), name in zip(self.pairs, self.names, strict=True):
                yield Capture(left, right, name)
            return
        both = zip(*(video.frames(path) for path in self.videos), strict=False)
        for name, (left, right) in zip(self.names, islice(both, 0, None, self.every), strict=False):
            yield Capture(*self.videos, name, (left.pixels, right.pixels))


def _count(path: Path) -> int:
    """Return how many frames a video has."""
    times = video.stamps(path)
    return sum(1 for _ in video.frames(path)) if times is None else len(times)


def document(report: RunReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    rectified = report.rectification
    return {
        "rig": report.rig_file.as_posix(),
        "rectified": report.rectified_file.as_posix(),
        "calibrated": report.calibration is not None,
        "trustworthy": None if report.calibration is None else report.calibration.trustworthy,
        "projection": rectified.projection,
        "axis": rectified.axis,
        "image_size": list(rectified.size),
        "baseline_m": rectified.baseline,
        "left": rectified.left,
        "right": rectified.right,
        "pairs": [_plain(pair) for pair in report.pairs],
        "reused": reused(report.outcomes),
        "failures": messages.as_data(report.failures),
        "failed": [
            {
                "left": outcome.item.left.as_posix(),
                "right": outcome.item.right.as_posix(),
                "message": str(outcome.error),
            }
            for outcome in report.outcomes
            if outcome.error is not None
        ],
    }


def _plain(pair: RunPair) -> dict[str, Any]:
    names = ("min", "median", "max")
    return {
        "name": pair.capture.name,
        "left": pair.capture.left.as_posix(),
        "right": pair.capture.right.as_posix(),
        "rectified": [pair.files.left.as_posix(), pair.files.right.as_posix()],
        "disparity": pair.files.map.as_posix(),
        "cloud": pair.files.cloud.as_posix(),
        "page": None if pair.page is None else pair.page.as_posix(),
        "check": None if pair.check is None else stereo_words.plain(pair.check),
        "matched": pair.figures.matched,
        "median_px": pair.figures.median,
        "sigma_px": pair.figures.sigma,
        "points": pair.cloud.points,
        "depth_m": dict(zip(names, pair.cloud.depth, strict=True)) if pair.cloud.depth else None,
        "frame": pair.cloud.frame,
        "warnings": messages.as_data(pair.warnings),
    }
