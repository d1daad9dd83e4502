"""`camcal pnp`: correspondences, or images of a board or of tags, and a camera or a rig of them, to poses.

A pose that is known beforehand is one of a pose file, or of a file with a pose as text.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, GateFailed, InsufficientData, InvalidInput
from camcal.estimate.poses.records import Correspondences, PoseEstimate, PoseOptions, PosePrior
from camcal.formats import cameras, correspondences, pose_text, poses
from camcal.formats.camera_file import CameraFile, rig_of
from camcal.formats.poses.record import PixelNoise, PoseKey, Poses
from camcal.geometry.pose import Pose, inverse_jacobian
from camcal.messages import Message, counted
from camcal.progress import SILENT, Progress, warn_of
from camcal.report import track_words
from camcal.report.overlays import Posed
from camcal.run.journal import journal_beside
from camcal.run.outputs import writes
from camcal.tasks.calibration.board_views import is_table
from camcal.tasks.given_camera import outside_region, read_camera_file, require_no_image
from camcal.tasks.poses import pnp_records
from camcal.tasks.poses.options import AUTO, INCONSISTENT, Gates, PnpOptions, PriorOptions
from camcal.tasks.poses.pnp_observer import Observer, Sheet, draw, joined, seen_by_rig, sheets, videos_in
from camcal.tasks.poses.pnp_records import record_of, typical_sigma
from camcal.tasks.poses.pnp_views import Observation, PnpViews, first_size, seen_by


@dataclass(frozen=True, eq=False)
class PnpReport:
    """The poses, warnings, pictures, and the images that failed: unreadable, or seen but without a pose.

    lines: other lines of the report. unsettled: those whose pose did not converge. views: the points and pixels of
    every pose, of one camera; camera: as it is for these images, None of a rig.
    """

    poses: Poses
    warnings: tuple[Message, ...]
    failed: tuple[str, ...]
    lines: tuple[str, ...] = ()
    unsettled: tuple[PoseKey, ...] = ()
    pictures: tuple[Path, ...] = ()
    views: Mapping[PoseKey, Correspondences] = field(default_factory=dict)
    camera: Camera | None = None

    def require_good(self, gates: Gates) -> None:
        """Raise GateFailed with the failures of all poses together and of each that does not pass."""
        found = [each for each in self.warnings if gates.require and each.code in INCONSISTENT]
        found += [
            each.at(pose_key) for pose_key, record in self.poses.estimates.items() for each in gates.failures(record)
        ]
        if found:
            raise GateFailed.of(found, where=gates.named(found))


@writes
def pnp(options: PnpOptions, progress: Progress = SILENT) -> PnpReport:
    """Return the pose of every object in every image, after writing them to options.output if that is given.

    Raises InvalidInput, FileError, or what kept the first image from a pose if none has one; nothing is written then.
    """
    _check(options)
    with journal_beside(options.output, options.detection.batch):
        return _estimated(options, progress)


def _estimated(options: PnpOptions, progress: Progress) -> PnpReport:
    file = read_camera_file(options.camera_file, options.given, progress, partial(_first_size_of, options))
    observer = _observer(options, file)
    names = (f"{observer.frame}_T_object", f"object_T_{observer.frame}")
    if options.pose not in (None, *names):
        raise InvalidInput(f"--pose {options.pose}: it is {names[0]} or {names[1]} here")
    inverse = options.pose == names[1]
    settings = _settings(options)
    prior = read_prior(options.prior, of_object=not inverse)
    observer, seen = _look(options, observer, file, progress)
    seen, settings = _with_noise(options, observer, seen, settings)
    settings = replace(settings, prior=prior)
    found, refused = observer.estimates(seen.observations, settings)
    refused = {**seen.refused, **refused}
    if not found:
        raise _why_no_pose(seen, refused)
    observations = {each.pose_key: each for each in seen.observations if each.pose_key in found}
    warnings = _warnings(observer, seen, found, list(observations.values()), settings)
    warnings += _outside_regions(options, file, observer, seen.observations)
    warn_of(warnings, progress)
    straight = _poses(options, observer, seen, found, refused)
    result = straight.inverse() if inverse else straight
    pages = _pages(options, observer, straight, found, observations)
    if options.output:
        poses.write(options.output, result)
    return PnpReport(
        result,
        (*seen.warnings, *warnings),
        lines=seen.lines,
        failed=(*seen.failed, *map(str, refused)),
        unsettled=tuple(pose_key for pose_key, estimate in found.items() if not estimate.converged),
        pictures=draw(pages, videos_in(options.paths), _folders(options), options.detection, progress),
        views={} if options.rig else {pose_key: each.views[0] for pose_key, each in observations.items()},
        camera=None if options.rig else observer.cameras[None],
    )


def _check(options: PnpOptions) -> None:
    detection = options.detection
    path, name = options.address
    if path is not None:
        require_no_image(path)
    if options.points is None and not options.seen:
        raise InvalidInput("no input: give --points FILE, or images with --board BOARD or --tags TAGS")
    if options.points is not None and (options.seen or detection.board or detection.tags):
        raise InvalidInput("--points excludes --board, --tags and images")
    if options.points is not None and detection.scale:
        raise InvalidInput("--scale-intrinsics needs images, not a file of points")
    if options.rig and name:
        raise InvalidInput("--rig uses all cameras; leave the camera name out")
    if detection.board and detection.tags:
        raise InvalidInput("--board and --tags exclude each other")
    if options.noise_px is not None and options.noise_scale is not None:
        raise InvalidInput("--noise and --noise-scale exclude each other")


def _first_size_of(options: PnpOptions) -> tuple[int, int] | None:
    """Return the size of the first image that was seen, None if there is none."""
    pictures = [text for text in options.seen if not is_table(text)]
    return first_size(tuple(pictures), options.detection.recursive)[0] if pictures and not options.rig else None


def _observer(options: PnpOptions, file: CameraFile) -> Observer:
    path, name = options.address
    if options.rig:
        rig, frame = rig_of(file, str(path))
        return Observer.of_rig(rig, frame, {name: file.cameras[name].noise for name in rig.cameras})
    entry = cameras.select(file, name, str(path or "--camera-matrix"))
    return Observer.of_camera(entry.camera, entry.noise)


def _look(options: PnpOptions, observer: Observer, file: CameraFile, progress: Progress) -> tuple[Observer, PnpViews]:
    """Return what was seen, and the observer with its cameras as they are for images of this size."""
    rig, detection = observer.rig, options.detection
    if options.points is not None:
        sizes = {name: camera.image_size for name, camera in rig.cameras.items()} if rig else None
        read = correspondences.read(options.points, sizes or observer.cameras[None].image_size)
        pairs = zip(read.views, read.ids, strict=True)
        observations = tuple(Observation(PoseKey(view.image), (view,), (ids,)) for view, ids in pairs)
        seen = PnpViews(observations, spread="stated" if read.absolute else "relative")
        return observer, replace(seen, observations=joined(seen.observations))
    if rig is not None:
        rig, seen = seen_by_rig(rig, file, options.seen, detection, progress)
        return observer.resized(dict(rig.cameras.items()), rig), seen
    _, name = options.address
    camera, seen = seen_by(observer.cameras[None], name, file, options.seen, detection, progress)
    return observer.resized({None: camera}, None), seen


def _settings(options: PnpOptions) -> PoseOptions:
    """Return how to estimate, but for the noise and the prior."""
    outliers = options.outliers
    if outliers == AUTO:
        outliers = "few" if options.points is None else "many"
    return PoseOptions(
        outliers="none" if outliers == "none" else "few" if outliers == "few" else "many",
        threshold_px=options.threshold_px,
        seed=options.seed,
        intrinsics=options.intrinsics,
    )


def _with_noise(
    options: PnpOptions, observer: Observer, seen: PnpViews, settings: PoseOptions
) -> tuple[PnpViews, PoseOptions]:
    """Return what was seen with the covariances that count, and the settings with the noise."""
    noise, scale = (None if value == "auto" else value for value in (options.noise_px, options.noise_scale))
    relative = seen.has_covariances and seen.spread == "relative"
    if options.noise_px is None:
        if options.noise_scale is not None and (relative or not seen.has_covariances):
            raise InvalidInput("--noise-scale needs pixels with standard deviations; set --noise PX")
        given = 1.0 if options.noise_scale is None and seen.spread == "stated" else scale
        if seen.spread == "detected":
            seen = replace(seen, observations=observer.with_model_errors(seen.observations))
        return seen, replace(settings, noise_scale=given)
    if relative:
        return seen, replace(settings, noise_scale=noise)
    return seen.alike(), replace(settings, noise_px=noise)


def _poses(
    options: PnpOptions,
    observer: Observer,
    seen: PnpViews,
    found: Mapping[PoseKey, PoseEstimate],
    refused: Mapping[PoseKey, CamcalError],
) -> Poses:
    """Return frame_T_object of every sight."""
    some, matched = next(iter(found.values())), options.points is not None
    records = {
        each.pose_key: record_of(
            found[each.pose_key], each, observer.cameras, all_solutions=options.all_solutions, matched=matched
        )
        for each in seen.observations
        if each.pose_key in found
    }
    scale = some.noise_scale if seen.has_covariances and seen.spread != "relative" else None
    noise = PixelNoise(typical_sigma(list(found.values())), scale, some.degrees_of_freedom)
    missing = {**seen.nothing, **{pose_key: error.message for pose_key, error in refused.items()}}
    return Poses(f"{observer.frame}_T_object", seen.unit, noise, records, missing)


def _why_no_pose(seen: PnpViews, refused: Mapping[PoseKey, CamcalError]) -> CamcalError:
    if refused:
        pose_key, error = next(iter(refused.items()))
        return type(error)(error.message, where=str(pose_key))
    for pose_key, reason in seen.nothing.items():
        return InsufficientData(f"no pose from {counted(len(seen.nothing), 'image')}; {reason}", where=str(pose_key))
    return InsufficientData("no pose; no image could be read")


def _warnings(
    observer: Observer,
    seen: PnpViews,
    found: Mapping[PoseKey, PoseEstimate],
    observations: Sequence[Observation],
    settings: PoseOptions,
) -> list[Message]:
    estimates = list(found.values())
    expected = seen.spread == "detected" and bool(observer.noise_px or observer.model_errors_px)
    warnings = pnp_records.of_noise(estimates, observations, observer.noise_px, expected=expected)
    warnings += pnp_records.of_outliers(estimates, observations)
    if seen.unit == "m":
        warnings += pnp_records.of_units(estimates, observations)
    if observer.rig is not None:
        warnings += pnp_records.of_rig(estimates, observations)
    else:
        views = [observation.views[0] for observation in observations]
        warnings += pnp_records.of_lens(observer.cameras[None], views, estimates, settings)
    return warnings


def _outside_regions(
    options: PnpOptions, file: CameraFile, observer: Observer, observations: Sequence[Observation]
) -> Iterator[Message]:
    """Yield a warning for every camera that saw points where the verdict on it does not hold."""
    path, selected = options.address
    for name, camera in observer.cameras.items():
        entry = cameras.select(file, selected, str(path)) if name is None else file.cameras[name]
        scale = np.array(entry.camera.image_size) / camera.image_size  # the images may be smaller
        seen = [view.pixels for own in observations for view in own.views if name in (None, view.camera)]
        pixels = scale * np.concatenate([np.zeros((0, 2)), *seen])
        yield from outside_region(entry.verdict, pixels, "the points", "calibrate with corners there", name)


def _folders(options: PnpOptions) -> list[Path]:
    """Return the folders in which images are searched for that are named by their names alone."""
    return [path.parent for path in (*options.paths, options.points) if path is not None]


def _pages(
    options: PnpOptions,
    observer: Observer,
    straight: Poses,
    found: Mapping[PoseKey, PoseEstimate],
    observations: Mapping[PoseKey, Observation],
) -> list[Sheet]:
    """Return what is to be drawn of the poses, which take points of the object to the camera or rig."""
    if options.draw is None:
        return []
    objects: dict[tuple[str, str | None], list[Posed]] = {}
    for pose_key, estimate in found.items():
        words = track_words.caption(straight, pose_key, straight.estimates[pose_key])
        for key, posed in observer.posed(observations[pose_key], estimate, words).items():
            objects.setdefault(key, []).append(posed)
    for image in {image for image, _ in objects}:
        for place in (Path(image), *(folder / image for folder in _folders(options))):
            files.note_read(place)
    return sheets(objects, options.draw)


def document(report: PnpReport) -> dict[str, Any]:
    """Return the report as plain data for --json."""
    return {
        **poses.document(report.poses),
        "failed": list(report.failed),
        "pictures": [path.as_posix() for path in report.pictures],
    }


def read_prior(options: PriorOptions, of_object: bool) -> PosePrior | None:
    """Return the prior of the object's pose in the frame of the camera or rig, None without one.

    of_object: whether a pose as text takes points of the object to the camera; a pose file says so itself.
    Raises InvalidInput for a pose file with several poses, and if nothing says how well the pose is known.
    """
    if options.path is None:
        return None
    if options.path.suffix.lower() in poses.SUFFIXES:
        found = poses.read(options.path)
        if len(found.estimates) != 1:
            raise InvalidInput(f"holds {len(found.estimates)} poses; a prior is one", where=str(options.path))
        record = next(iter((found if found.of_object else found.inverse()).estimates.values()))
        pose, covariance = record.transform, record.covariance
    else:
        pose, covariance = pose_text.read(options.path), None
        if not of_object:
            pose = pose.inverse()
    if options.sigma is not None:
        covariance = _isotropic(pose, options.sigma, of_object)
    if covariance is None:
        raise InvalidInput(
            "a pose as text has no covariance: give --prior-sigma METRES,DEGREES", where=str(options.path)
        )
    return PosePrior(pose, covariance)


def _isotropic(pose: Pose, sigma: tuple[float, float], of_object: bool) -> Array:
    """Return the covariance (6, 6) of camera_T_object where its own steps, or those of its inverse, have `sigma`."""
    covariance = np.diag(np.repeat(np.square(sigma), 3))
    if of_object:
        return covariance
    jacobian = inverse_jacobian(pose.inverse())
    return np.asarray(jacobian @ covariance @ jacobian.T)
