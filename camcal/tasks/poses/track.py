"""`camcal track`: poses of single frames, or the frames themselves, to tracks of objects over time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camcal import files
from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field
from camcal.errors import CamcalError, InsufficientData, InvalidInput
from camcal.estimate.poses.records import Correspondences
from camcal.estimate.tracking.measurements import GateOptions
from camcal.estimate.tracking.process_noise import ProcessNoise
from camcal.estimate.tracking.track import Track, TrackOptions, track_poses, track_views
from camcal.formats import poses, trajectories
from camcal.formats.poses.record import PoseKey, PoseRecord, Poses
from camcal.formats.trajectories.tracked import SUFFIXES, TrackedObject, write_tracks
from camcal.geometry.pose import Trajectory
from camcal.messages import Message
from camcal.parsing import did_you_mean
from camcal.progress import SILENT, Progress, warn_of
from camcal.report import track_words
from camcal.run.outputs import writes
from camcal.run.paths import find_media, refuse_collisions, require_there
from camcal.targets.markers import single_name
from camcal.tasks.figure_files import figure_data, write_figures
from camcal.tasks.given_camera import require_no_image
from camcal.tasks.poses.frame_times import frame_times, require_times
from camcal.tasks.poses.options import PnpOptions
from camcal.tasks.poses.pnp import pnp
from camcal.tasks.poses.smooth_options import TrackingOptions

if TYPE_CHECKING:
    from camcal.report.figures.figure import Plot

_OF_CAMERA = ("tum",)  # forms that are about the path of a camera, not of an object


@dataclass(frozen=True, eq=False)
class TrackReport:
    """The tracks by object, the names of their frames, objects that could not be followed, and warnings.

    lines: other lines of the report. failed: images that could not be read. outputs: the files that were written;
    figures: those of figures.
    """

    images: tuple[str, ...]
    objects: Mapping[str, TrackedObject]
    lost: Mapping[str, CamcalError]
    warnings: tuple[Message, ...] = ()
    lines: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()
    outputs: tuple[Path, ...] = ()
    figures: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class _FramePoses:
    """Poses of single frames, the names of all frames in order, the videos they stem from, and warnings.

    views: points and pixels of the poses, and the camera that took them; None for a pose file, which has none.
    """

    poses: Poses
    images: tuple[str, ...]
    videos: tuple[Path, ...] = ()
    warnings: tuple[Message, ...] = ()
    lines: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()
    views: Mapping[PoseKey, Correspondences] = field(default_factory=dict)
    camera: Camera | None = None


@writes
def track(options: TrackingOptions, progress: Progress = SILENT) -> TrackReport:
    """Return the tracks of all objects, after writing them and their picture where that is asked for.

    Raises InvalidInput, FileError, or InsufficientData if no object can be followed; nothing is written then.
    """
    if options.output is not None:
        if options.kind is not None or options.output.suffix.lower() not in SUFFIXES:
            trajectories.kind_of(options.output, options.kind)
    elif options.kind is not None:
        raise InvalidInput("--format needs an output (-o)")
    seen = _of_file(options) if options.of_poses else _of_images(options, progress)
    if seen.poses.unit != "m":
        raise InvalidInput(f"lengths are in {seen.poses.unit}, not in metres; give the board size")
    direction = _direction(options, seen.poses)
    stamps = frame_times(seen.images, seen.videos, options.timing, progress)
    straight = seen.poses if seen.poses.of_object else seen.poses.inverse()
    objects: dict[str, TrackedObject] = {}
    lost: dict[str, CamcalError] = {}
    names = _chosen(straight, options.object if options.tag_id is None else single_name(options.tag_id))
    progress.start("following", len(names))
    for name in names:
        progress.advance()
        single = [straight.estimates.get(PoseKey(image, name)) for image in seen.images]
        try:
            found = _followed(options, seen, name, stamps, single, straight.frames)
        except InsufficientData as error:
            lost[name] = InsufficientData(error.message, where=name or options.frames[0])
            continue
        shown = found if direction == straight.frames else found.inverse()
        objects[name] = TrackedObject(shown, single if shown is found else [each and each.inverse() for each in single])
    progress.finish()
    if not objects:
        raise next(iter(lost.values()))
    outputs = _written(options, seen.images, objects)
    warnings = [
        each.at(name) if name else each
        for name, item in objects.items()
        for each in track_words.warnings(item, of_poses=options.of_poses)
    ]
    warn_of(warnings, progress)
    return TrackReport(
        seen.images,
        objects,
        lost,
        warnings=(*seen.warnings, *warnings),
        lines=seen.lines,
        failed=seen.failed,
        outputs=outputs,
        figures=_write_figures(options, objects),
    )


def _followed(
    options: TrackingOptions,
    seen: _FramePoses,
    name: str,
    stamps: Array,
    single: Sequence[PoseRecord | None],
    frames: str,
) -> Track:
    """Return the track of an object, from its pixels where there are any."""
    if seen.camera is None:
        return track_poses(stamps, single, _tracking(options), frames)
    views = [seen.views.get(PoseKey(image, name)) for image in seen.images]
    return track_views(seen.camera, stamps, views, single, _tracking(options), options.noise_px)


def _tracking(options: TrackingOptions) -> TrackOptions:
    noise = None if options.process_noise is None else ProcessNoise(*options.process_noise)
    lag = 0 if options.causal else options.lag
    return TrackOptions(noise, GateOptions(options.gate, options.max_gap), lag, options.fill)


def _of_file(options: TrackingOptions) -> _FramePoses:
    path = Path(options.frames[0])
    require_no_image(path)
    if len(options.frames) != 1:
        raise InvalidInput("one pose file only; frames need a camera file")
    if options.detection.board or options.detection.tags:
        raise InvalidInput("a pose file excludes --board and --tags")
    if options.noise_px is not None:
        raise InvalidInput("a pose file excludes --noise; set it in 'camcal pnp'")
    require_there(path)
    read = poses.read(path)
    images = {pose_key.image for pose_key in (*read.estimates, *read.missing)}
    return _FramePoses(read, tuple(sorted(images, key=files.natural_key)))


def _of_images(options: TrackingOptions, progress: Progress) -> _FramePoses:
    media = find_media(options.frames, options.detection.recursive)
    if len(media.videos) > 1 or (media.videos and media.images):
        raise InvalidInput(f"{len(media.videos)} videos and {len(media.images)} images; give one video, or images")
    require_times(media.videos, options.timing)
    found = pnp(
        PnpOptions(
            options.camera,
            inputs=options.frames,
            given=options.given,
            detection=options.detection,
            name=options.name,
            noise_px=options.noise_px,
        ),
        progress,
    )
    known = {str(pose_key) for pose_key in found.poses.missing}
    failed = tuple(line for line in found.failed if line not in known)
    names = {pose_key.image for pose_key in (*found.poses.estimates, *found.poses.missing)} | {
        path.as_posix() for path in media.images
    }
    return _FramePoses(
        found.poses,
        tuple(sorted(names, key=files.natural_key)),
        videos=media.videos,
        warnings=found.warnings,
        lines=found.lines,
        failed=failed,
        views=found.views,
        camera=found.camera,
    )


def _direction(options: TrackingOptions, seen: Poses) -> str:
    """Return the frames that are written; raises InvalidInput for a name that is neither of both."""
    straight = seen.frames if seen.of_object else seen.inverse().frames
    turned = "_T_".join(reversed(straight.split("_T_")))
    if options.pose not in (None, straight, turned):
        raise InvalidInput(f"--pose {options.pose}: it is {straight} or {turned} here")
    if options.pose is not None:
        return options.pose
    return turned if options.output is not None and _form(options) in _OF_CAMERA else straight


def _form(options: TrackingOptions) -> str | None:
    """Return the form of trajectory that is written, None for a track with all its frames."""
    if options.output is None or (
        options.kind is None and (files.is_stream(options.output) or options.output.suffix.lower() in SUFFIXES)
    ):
        return None
    return trajectories.kind_of(options.output, options.kind)


def _chosen(seen: Poses, wanted: str | None) -> list[str]:
    """Return the names of the objects to follow, in natural order."""
    names = sorted({pose_key.object for pose_key in seen.estimates}, key=files.natural_key)
    if wanted is None:
        return names
    if names == [""]:
        raise InvalidInput(f"--object {wanted}: there is one unnamed object; leave the option out")
    if wanted not in names:
        raise InvalidInput(f"--object {wanted}: not detected{did_you_mean(wanted, names)}")
    return [wanted]


def _written(options: TrackingOptions, images: Sequence[str], objects: Mapping[str, TrackedObject]) -> tuple[Path, ...]:
    """Write the tracks and their pictures as far as they are asked for, and return the files."""
    outputs = []
    if options.output is not None:
        form = _form(options)
        if form is None:
            write_tracks(options.output, images, objects)
        else:
            trajectories.write(options.output, _trajectory(options.output, objects), form)
        outputs.append(options.output)
    if options.plot is not None:
        from camcal.report.figures.figure import encoded
        from camcal.report.figures.over_time import track_over_time

        for path, (name, item) in zip(_plots(options.plot, list(objects)), objects.items(), strict=True):
            single = [None if each is None else each.transform for each in item.single]
            title = f"{item.track.frames}{f', {name}' if name else ''}"
            gate = _tracking(options).following.gate
            files.write_bytes(path, encoded(track_over_time(item.track, single, title, gate), path.suffix))
            outputs.append(path)
    return tuple(outputs)


def _write_figures(options: TrackingOptions, objects: Mapping[str, TrackedObject]) -> tuple[Path, ...]:
    if options.figures.folder is None:
        return ()
    from camcal.report.figures.figure import of_part
    from camcal.report.figures.over_time import track_plots
    from camcal.report.figures.trajectories import path_of, trajectory_plots

    plots: list[Plot] = []
    for name, item in objects.items():
        single = [None if each is None else each.transform for each in item.single]
        over_time = track_plots(item.track, single, _tracking(options).following.gate)
        own = (*over_time, *trajectory_plots(path_of(posed(item.track))))
        plots += of_part(own, name) if name else own
    return write_figures(options.figures, plots)


def _plots(plot: Path, names: Sequence[str]) -> list[Path]:
    """Return the picture of every object: of several, the object's name is added to the file's."""
    if len(names) == 1:
        return [plot]
    paths = {Path(name): plot.with_stem(f"{plot.stem}_{files.stem_of(name)}") for name in names}
    refuse_collisions(paths)
    return list(paths.values())


def _trajectory(output: Path, objects: Mapping[str, TrackedObject]) -> Trajectory:
    """Return the poses of the one object that the form has room for."""
    if len(objects) > 1:
        raise InvalidInput(
            f"holds one object, and {len(objects)} were followed ({', '.join(objects)}): choose one with --object, "
            f"or write {' '.join(SUFFIXES)}",
            where=str(output),
        )
    (track,) = (item.track for item in objects.values())
    return posed(track)


def posed(track: Track) -> Trajectory:
    """Return the poses of a track as a trajectory."""
    there = track.posed
    return Trajectory(
        track.frames,
        track.stamps[there],
        rotations=track.rotations[there],
        translations=track.translations[there],
        covariances=track.covariances[there],
        velocities=track.velocities[there],
        segments=track.segments[there],
    )


def document(report: TrackReport) -> dict[str, Any]:
    """Return the report as plain data for --json; the poses themselves are in the file."""
    return {
        "frame_count": len(report.images),
        "objects": [{"object": name} | track_words.plain(item, report.images) for name, item in report.objects.items()],
        "lost": [{"object": name, "message": error.message} for name, error in report.lost.items()],
        "failed": list(report.failed),
        "outputs": list(report.outputs),
        **figure_data(report.figures),
    }
