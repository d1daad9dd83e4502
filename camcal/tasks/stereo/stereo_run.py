"""`camcal stereo run`: (calibrate →) rectify → check → disparity → cloud → view, for all pairs of two cameras.

Each pair goes from two images to a cloud and a page, with all that is written on the way.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from camcal import files, records
from camcal.arrays import PixelArray
from camcal.dataclass import dataclass, replace
from camcal.errors import GateFailed, InsufficientData, InvalidInput, ItemsFailed
from camcal.formats import native
from camcal.formats.native import untrustworthy
from camcal.images import video
from camcal.images.files import load, save
from camcal.messages import Message
from camcal.options import command_line
from camcal.progress import SILENT, Collected, Outcome, Progress, failed_items, reused, warn_of
from camcal.report import cloud_view, stereo_words
from camcal.report.cloud_scene import gather
from camcal.report.cloud_view import Start
from camcal.report.colour_scale import paint_of
from camcal.run import fingerprint
from camcal.run.outputs import claim, writes
from camcal.run.paths import find_media, find_pairs, place
from camcal.run.resume import Items, resumable
from camcal.stereo.pair_check import PairCheck
from camcal.stereo.rectify.record import Rectification
from camcal.tasks.options import GivenCamera
from camcal.tasks.rigs.calibrate_rig import calibrated
from camcal.tasks.rigs.rig_result import RigReport
from camcal.tasks.rigs.rig_views import rig_views
from camcal.tasks.stereo.cloud import CloudReport, require_points, source_of_match, write_points
from camcal.tasks.stereo.options import PAGE, DisparityOptions
from camcal.tasks.stereo.rig_pair import (
    GivenRig,
    PairImages,
    RigPair,
    match_images,
    read_rig,
    rectified_file,
    rectified_pair,
    rig_pair,
)
from camcal.tasks.stereo.run_options import CloudOptions, RunOptions
from camcal.tasks.stereo.stereo_check import check_images
from camcal.tasks.stereo.stereo_disparity import Figures, MapFiles, for_png, write_map
from camcal.tasks.stereo.view import MOST_POINTS, cloud_in

_PICTURE, _MAP, _PAGE = ".png", ".tiff", ".html"
RIG, RECTIFIED = "rig.yaml", "rectified.yaml"
_LARGE = 4_000_000  # pixels; of larger pairs one at a time is matched, for the memory that each takes


class Capture(NamedTuple):
    """Two images that were taken together, as the rig orders its cameras; frames: of videos, else None for both."""

    left: Path
    right: Path
    name: str
    frames: tuple[PixelArray, PixelArray] | None = None


class RunFiles(NamedTuple):
    """What is written of a pair."""

    left: Path
    right: Path
    map: Path
    cloud: Path
    page: Path

    @classmethod
    def of(cls, folder: Path, name: str, cloud_type: str) -> "RunFiles":
        """Return the files of a pair in the folder of a run."""
        left, right = (folder / "rectified" / side / f"{name}{_PICTURE}" for side in ("left", "right"))
        cloud = folder / "clouds" / f"{name}.{cloud_type}"
        return cls(left, right, folder / "disparity" / f"{name}{_MAP}", cloud, folder / "views" / f"{name}{_PAGE}")

    def every(self) -> Iterator[Path]:
        """Yield all of them, those beside the map among them."""
        yield from (self.left, self.right, self.cloud, self.page)
        yield from MapFiles.beside(self.map)


@dataclass(frozen=True, eq=False)
class RunPair:
    """What became of a pair: its check (None if too little of it can be matched), its map, its cloud, and its page.

    page: None for an empty cloud. warnings: what is weak; failures: why the pair or its map cannot be used.
    """

    capture: Capture
    files: RunFiles
    check: PairCheck | None
    figures: Figures
    cloud: CloudReport
    page: Path | None
    warnings: tuple[Message, ...]
    failures: tuple[Message, ...]


@dataclass(frozen=True, eq=False)
class PairRun:
    """How pairs are run: their rectification, made once for all of them, and the options.

    jobs: threads for one pair.
    """

    rig: RigPair
    options: RunOptions
    jobs: int | None = 1

    def __call__(self, capture: Capture) -> RunPair:
        """Return what became of a pair; raises InvalidInput and FileError."""
        options, places = self.options, RunFiles.of(self.options.output, capture.name, self.options.clouds)
        images = self._rectified(capture)
        save(places.left, for_png(images.left))
        save(places.right, for_png(images.right))
        images = replace(images, image=places.left)
        check, doubts = _check(images)
        found = match_images(images, options.matching, jobs=self.jobs)
        own = DisparityOptions((), (), places.map, matching=options.matching)
        matched = write_map(images, found, MapFiles.beside(places.map), own, None)
        heard = Collected()
        how = CloudOptions(places.map, places.cloud, points=options.points, vertices=options.vertices, jobs=self.jobs)
        cloud = write_points(how, source_of_match(images, found), heard)
        page = None
        if cloud.points:
            page, scene = places.page, gather(cloud_in(places.cloud), MOST_POINTS[PAGE])
            files.write_text(page, cloud_view.page(scene, capture.name, Start(paint_of(scene, None).name)))
        warnings = (*doubts, *matched.warnings, *heard.warnings)
        named = capture._replace(frames=None)  # frames would be kept for as long as the report is
        figures = None if check is None else check.figures()
        return RunPair(named, places, figures, matched.figures, cloud, page, warnings, matched.failures)

    def _rectified(self, capture: Capture) -> PairImages:
        sources = (capture.left, capture.right)
        pixels = capture.frames or (load(capture.left).pixels, load(capture.right).pixels)
        if self.rig.rectification.swapped:
            sources, pixels = sources[::-1], pixels[::-1]
        return rectified_pair(sources, pixels[0], pixels[1], self.rig)


def _check(images: PairImages) -> tuple[PairCheck | None, tuple[Message, ...]]:
    """Return the check of rectified images, or why there is none; what is wrong with the pair the matching says too."""
    try:
        return check_images(images), ()
    except (InsufficientData, InvalidInput) as error:
        return None, (Message("rows_not_checked", f"row offsets not checked: {error.message}"),)


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
    require_points(options.points, options.vertices)
    scene = _Scene.of(options)
    folder = options.output
    rectified = folder / RECTIFIED
    outputs = [path for name in scene.names for path in RunFiles.of(folder, name, options.clouds).every()]
    claim([*outputs, rectified, *([] if options.rig else [folder / RIG])])
    calibration = None if options.rig else _calibrate(options, folder / RIG, progress)
    address = options.rig or str(folder / RIG)
    # what is said of a file made here, its calibration has said already
    heard = SILENT if calibration else progress
    rig = read_rig(address, options.cameras, scene.size, given=GivenCamera(part=options.part), progress=heard)
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


def _calibrate(options: RunOptions, path: Path, progress: Progress) -> RigReport:
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
    outputs = partial(_outputs, options)
    pairs: Items[Capture, RunPair] = Items(fingerprint.of_data(facts), _inputs, outputs, RunPair, _named)
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


def _outputs(options: RunOptions, capture: Capture) -> list[Path]:  # at the top, so that worker processes find it
    return list(RunFiles.of(options.output, capture.name, options.clouds).every())


def _inputs(capture: Capture) -> list[Path | str]:
    """Return what a pair is: its images, or the frames of its videos, and the names that its files hold."""
    names = [path.as_posix() for path in _named(capture)]
    if capture.frames is None:
        return [*_named(capture), *names]
    return [*map(fingerprint.of_array, capture.frames), *names]


def _named(capture: Capture) -> tuple[Path, Path]:
    return capture.left, capture.right


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
        "rig": report.rig_file,
        "rectified": report.rectified_file,
        "calibrated": report.calibration is not None,
        "trustworthy": None if report.calibration is None else report.calibration.trustworthy,
        "projection": rectified.projection,
        "axis": rectified.axis,
        "image_size": rectified.size,
        "baseline_m": rectified.baseline,
        "left": rectified.left,
        "right": rectified.right,
        "pairs": [_plain(pair) for pair in report.pairs],
        "reused": reused(report.outcomes),
        "failures": report.failures,
        "failed": failed_items(report.outcomes, "left", "right"),
    }


def _plain(pair: RunPair) -> dict[str, Any]:
    cloud = records.document(pair.cloud)
    return {
        "name": pair.capture.name,
        "left": pair.capture.left,
        "right": pair.capture.right,
        "rectified": [pair.files.left, pair.files.right],
        "disparity": pair.files.map,
        "cloud": pair.files.cloud,
        "page": pair.page,
        "check": None if pair.check is None else stereo_words.plain(pair.check),
        "matched": pair.figures.matched,
        "median_px": pair.figures.median,
        "sigma_px": pair.figures.sigma,
        **{name: cloud[name] for name in ("points", "depth_m", "frame")},
        "warnings": pair.warnings,
    }
