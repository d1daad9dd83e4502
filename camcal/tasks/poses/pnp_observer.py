"""The observer of poses: one camera, or a rig of several cameras with common instants.

Pictures of the poses are drawn over the images they come from, as many at a time as there are cores.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera, Rig
from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.estimate.pnp import estimate_poses, estimate_rig_poses
from camcal.estimate.poses.records import Correspondences, PoseEstimate, PoseOptions
from camcal.formats.camera_file import CalibrationNoise, CameraFile
from camcal.formats.poses.record import PoseKey
from camcal.geometry.pose import Pose
from camcal.images.bag import addressed
from camcal.images.files import KINDS, gray_8bit, save
from camcal.images.video import frame_name, frames
from camcal.images.videos import is_video
from camcal.messages import Message
from camcal.parsing import did_you_mean
from camcal.progress import Progress, values_of, warn_of
from camcal.raw.reading import read_detection_image
from camcal.report.overlays import Posed, overlay
from camcal.run.fanout import fan_out
from camcal.run.outputs import claim
from camcal.run.paths import IMAGE_SUFFIXES, names_file, refuse_collisions, require_one
from camcal.tasks.calibration.board_views import is_table
from camcal.tasks.poses.options import DetectionOptions
from camcal.tasks.poses.pnp_views import Observation, PnpViews, seen_by

CAMERA = "camera"
SYNTAX = "give CAMERA=IMAGES for each camera, such as left=photos/left right=photos/right"
_SUFFIX = "_pose.png"
_BLANK = 110  # gray level where the image itself is not there


def _known(noise: Mapping[Any, CalibrationNoise | None]) -> dict[str | None, float]:
    """Return the model errors by camera, of the cameras that have one."""
    return {name: each.model_error_px for name, each in noise.items() if each and each.model_error_px}


@dataclass(frozen=True, eq=False)
class Observer:
    """The cameras by the names that views have (None where there is one only), and the rig they make, if any.

    frame: its name in transforms. noise_px: that of the camera's calibration, None if it is not known.
    model_errors_px: what board and lens model left of it by the names of cameras, as far as it is known.
    """

    frame: str
    cameras: Mapping[str | None, Camera]
    rig: Rig | None = None
    noise_px: float | None = None
    model_errors_px: Mapping[str | None, float] = field(default_factory=dict)

    @classmethod
    def of_camera(cls, camera: Camera, noise: CalibrationNoise | None = None) -> "Observer":
        """Return an observer that is one camera; noise: of its calibration."""
        errors = _known({None: noise})
        return cls(CAMERA, {None: camera}, noise_px=noise.sigma_px if noise else None, model_errors_px=errors)

    @classmethod
    def of_rig(cls, rig: Rig, frame: str, noise: Mapping[str, CalibrationNoise | None]) -> "Observer":
        """Return an observer that is a rig; noise: of the calibrations of its cameras."""
        return cls(frame, dict(rig.cameras.items()), rig, model_errors_px=_known(noise))

    def resized(self, cameras: Mapping[str | None, Camera], rig: Rig | None) -> "Observer":
        """Return the same with cameras as they are for images of another size."""
        scales = {name: cameras[name].image_size[0] / camera.image_size[0] for name, camera in self.cameras.items()}
        errors = {name: scales[name] * error for name, error in self.model_errors_px.items()}
        return replace(self, cameras=cameras, rig=rig, model_errors_px=errors)

    def estimates(
        self, observations: Sequence[Observation], settings: PoseOptions
    ) -> tuple[dict[PoseKey, PoseEstimate], dict[PoseKey, CamcalError]]:
        """Return frame_T_object of every sight, and what kept others from a pose."""
        results: list[tuple[PoseEstimate | None, CamcalError | None]]
        if self.rig is None:
            single = estimate_poses(self.cameras[None], [each.views[0] for each in observations], settings)
            results = [(outcome.value, outcome.error) for outcome in single]
        else:
            joint = estimate_rig_poses(self.rig, [each.views for each in observations], settings)
            results = [(outcome.value, outcome.error) for outcome in joint]
        pose_keys = [each.pose_key for each in observations]
        found = {pose_key: value for pose_key, (value, _) in zip(pose_keys, results, strict=True) if value is not None}
        return found, {
            pose_key: error for pose_key, (_, error) in zip(pose_keys, results, strict=True) if error is not None
        }

    def posed(
        self, observation: Observation, estimate: PoseEstimate, words: str
    ) -> dict[tuple[str, str | None], Posed]:
        """Return an object as each of the cameras saw it, by image and camera; words: what a picture says of it."""
        return {
            (view.image, view.camera): Posed(
                self.cameras[view.camera],
                self._pose_in(view.camera, estimate.transform),
                points=view.points,
                pixels=view.pixels,
                inliers=mask,
                words=words,
                name=observation.pose_key.object,
            )
            for view, mask in observation.by_view(estimate.inliers)
        }

    def with_model_errors(self, observations: Sequence[Observation]) -> tuple[Observation, ...]:
        """Return observations whose pixels' covariances have the cameras' model errors added."""
        return tuple(replace(each, views=tuple(map(self._with_model_error, each.views))) for each in observations)

    def _with_model_error(self, view: Correspondences) -> Correspondences:
        if view.covariance is None or view.camera not in self.model_errors_px:
            return view
        return replace(view, covariance=view.covariance + self.model_errors_px[view.camera] ** 2 * np.eye(2))

    def _pose_in(self, camera: str | None, frame_T_object: Pose) -> Pose:
        """Return camera_T_object of one of the cameras."""
        if self.rig is None or camera is None:
            return frame_T_object
        return self.rig.rig_T_camera[camera].inverse() @ frame_T_object


def seen_by_rig(
    rig: Rig, file: CameraFile, inputs: tuple[str, ...], detection: DetectionOptions, progress: Progress
) -> tuple[Rig, PnpViews]:
    """Return what images, videos or detections files show of a board or of tags to the cameras of a rig.

    The rig comes first, with its cameras as they are for images of this size. inputs: CAMERA=PATH for each camera, or
    one detections file that names the cameras. Images of one name, but for that of the camera in it, are of one
    instant, as are the frames of one number of a video each.
    Raises InvalidInput for other inputs, for two images of a camera at one instant and for units that differ.
    """
    given = _by_camera(inputs, list(rig.cameras))
    found = {name: seen_by(rig.cameras[name], name, file, paths, detection, progress) for name, paths in given.items()}
    fitted = rig.resized({name: camera.image_size for name, (camera, _) in found.items()})
    seen = {name: each for name, (_, each) in found.items()}
    units = {each.unit for each in seen.values()}
    if len(units) > 1:
        raise InvalidInput("boards with and without a size; use the same --board for all cameras")
    single = all(len({pose_key.image for pose_key in _sights(each)}) == 1 for each in seen.values())
    observations = [_by_instant(name, each, given[name], single) for name, each in seen.items()]
    together = joined([observation for each in observations for observation in each])
    alone: tuple[Message, ...] = ()
    if len(seen) > 1 and together and not any(len(each.views) > 1 for each in together):
        text = (
            f"no object was seen by two cameras at one instant, such as {together[0].pose_key}: name the images of one "
            "instant alike but for the camera"
        )
        alone = (Message("no_common_instants", text),)
        warn_of(alone, progress)
    return fitted, PnpViews(
        together,
        units.pop(),
        nothing={pose_key: reason for each in seen.values() for pose_key, reason in each.nothing.items()},
        refused={pose_key: error for each in seen.values() for pose_key, error in each.refused.items()},
        warnings=(*(warning for each in seen.values() for warning in each.warnings), *alone),
        lines=tuple(dict.fromkeys(line for each in seen.values() for line in each.lines)),
        failed=tuple(line for each in seen.values() for line in each.failed),
    )


def joined(observations: Iterable[Observation]) -> tuple[Observation, ...]:
    """Return one observation for each pose_key: what the cameras saw under that name."""
    instants: dict[PoseKey, list[Observation]] = {}
    for observation in observations:
        instants.setdefault(observation.pose_key, []).append(observation)
    return tuple(
        Observation(
            pose_key,
            tuple(view for part in parts for view in part.views),
            tuple(ids for part in parts for ids in part.ids),
        )
        for pose_key, parts in instants.items()
    )


def _by_camera(inputs: tuple[str, ...], names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the inputs of every camera."""
    if len(inputs) == 1 and is_table(inputs[0]) and "=" not in inputs[0]:
        return dict.fromkeys(names, inputs)
    found: dict[str, tuple[str, ...]] = {}
    for text in inputs:
        name, mark, path = text.partition("=")
        if not (mark and path):
            raise InvalidInput(f"no camera given: {SYNTAX}", where=text)
        if name not in names:
            raise InvalidInput(f"no camera {name!r} in the rig{did_you_mean(name, names)}", where=text)
        found[name] = (*found.get(name, ()), path)
    return found


def _sights(seen: PnpViews) -> list[PoseKey]:
    return [*(observation.pose_key for observation in seen.observations), *seen.nothing, *seen.refused]


def _by_instant(camera: str, seen: PnpViews, inputs: tuple[str, ...], single: bool) -> list[Observation]:
    """Return what a camera saw by the name of the instant; single: there is one image of every camera."""
    videos = [path.stem for path in videos_in([Path(text) for text in inputs])]
    found: dict[PoseKey, Observation] = {}
    for observation in seen.observations:
        instant = "instant" if single else _instant(Path(observation.pose_key.image).name, camera, videos)
        pose_key = observation.pose_key._replace(image=instant)
        if pose_key in found:
            both = f"{found[pose_key].views[0].image} and {observation.pose_key.image}"
            raise InvalidInput(f"{both} are two images of camera {camera!r} at one instant, {instant!r}; rename one")
        views = tuple(replace(view, camera=camera) for view in observation.views)
        found[pose_key] = replace(observation, pose_key=pose_key, views=views)
    return list(found.values())


def _instant(name: str, camera: str, videos: Sequence[str]) -> str:
    """Return the name of an image without the camera's, or the number of a frame of a video."""
    for stem in videos:
        if re.fullmatch(rf"{re.escape(stem)}_\d+", name):
            return name.removeprefix(f"{stem}_")
    end = "(?![A-Za-z])" if camera[-1].isalpha() else "(?![A-Za-z0-9])"  # left01 is of left, cam01 not of cam0
    bare = re.sub(rf"(?<![A-Za-z]){re.escape(camera)}{end}[_\-.]?", "", name)
    return bare if Path(bare).stem.strip("._-") else name


@dataclass(frozen=True, eq=False)
class Sheet:
    """A picture to be made: the name of the image as its views have it, and the objects in it."""

    image: str
    output: Path
    objects: tuple[Posed, ...]


Work = tuple[
    Sheet, Path | None, Array | None
]  # a page, the file of its image or, of a frame of a video, its gray values


def videos_in(paths: Sequence[Path]) -> list[Path]:
    """Return the videos among files and in folders."""
    folders = [path for path in paths if path.is_dir() and not is_video(path)]
    inside = [each for path in paths for each in (sorted(path.iterdir()) if path in folders else [path])]
    return [addressed(path) for path in inside if is_video(path)]


def sheets(objects: Mapping[tuple[str, str | None], Sequence[Posed]], output: Path) -> list[Sheet]:
    """Return one sheet for each image (its name, and its camera in a rig) with all objects in it.

    output: a folder, or of one image the file. Raises InvalidInput if two images would have one picture, or a picture
    must not be written.
    """
    if names_file(output, KINDS):
        require_one(output, len(objects))
        claim([output], elsewhere=True)
        return [Sheet(key[0], output, tuple(posed)) for key, posed in objects.items()]
    names = {key: f"{key[1]}_{Path(key[0]).stem}" if key[1] else Path(key[0]).stem for key in objects}
    if len(set(names.values())) < len(names):  # of several folders
        names = {key: f"{Path(key[0]).parent.name}_{name}" for key, name in names.items()}
    outputs = {key: output / f"{name}{_SUFFIX}" for key, name in names.items()}
    refuse_collisions({Path(image): outputs[image, camera] for image, camera in objects})
    claim(outputs.values(), elsewhere=True)
    return [Sheet(key[0], outputs[key], tuple(posed)) for key, posed in objects.items()]


def draw(
    pages: Sequence[Sheet],
    videos: Sequence[Path],
    folders: Sequence[Path],
    detection: DetectionOptions,
    progress: Progress,
) -> tuple[Path, ...]:
    """Return the pictures that were written, one for each image.

    videos: whose frames may be among the images. folders: in which other images are looked for by their names; what is
    nowhere, or has another size than the camera, is drawn on gray. Raises FileError if a picture cannot be written.
    """
    work, jobs, batch = _work(pages, videos, folders), detection.jobs, detection.batch
    return tuple(values_of(fan_out(_draw, work, jobs=jobs, batch=batch, what="drawing", progress=progress)))


def _work(pages: Sequence[Sheet], videos: Sequence[Path], folders: Sequence[Path]) -> Iterator[Work]:
    waiting = {page.image: page for page in pages}
    for video in videos:
        try:
            for number, image in enumerate(frames(video)):
                page = waiting.pop(frame_name(video, number), None)
                if page is not None:
                    yield page, None, gray_8bit(image.pixels)
        except CamcalError:  # it is among those that failed
            continue
    for page in pages:
        if page.image in waiting:
            places = [Path(page.image), *(folder / page.image for folder in folders)]
            yield page, next((place for place in places if _may_be_image(place)), None), None


def _may_be_image(path: Path) -> bool:
    """Tell whether a file is there that may be an image: points that name no image have the name of their own file."""
    return path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()


def _draw(work: Work) -> Path:
    sheet, source, gray = work
    width, height = sheet.objects[0].camera.image_size
    if gray is None and source is not None:
        gray = read_detection_image(source).gray
    if gray is None or gray.shape != (height, width):
        gray = np.full((height, width), _BLANK, np.uint8)
    save(sheet.output, overlay(gray, sheet.objects))
    return sheet.output
