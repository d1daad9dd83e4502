"""What the cameras of a rig saw at the same instants."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from camcal.cameras.rig import Rig
from camcal.errors import InvalidInput
from camcal.formats.camera_file import CameraFile
from camcal.formats.poses.record import Sight
from camcal.formats.schema import did_you_mean
from camcal.progress import Progress
from camcal.run.inputs import VIDEO_SUFFIXES
from camcal.tasks.calibration.board_views import DETECTION_SUFFIXES
from camcal.tasks.poses.options import Looking
from camcal.tasks.poses.pnp_views import Observation, Seen, seen_by

SYNTAX = "give CAMERA=IMAGES for each camera, such as left=photos/left right=photos/right"


def seen_by_rig(
    rig: Rig, file: CameraFile, inputs: tuple[str, ...], looking: Looking, progress: Progress
) -> tuple[Rig, Seen]:
    """Return what images, videos or detections files show of a board or of tags to the cameras of a rig.

    The rig comes first, with its cameras as they are for images of this size. inputs: CAMERA=PATH for each camera, or
    one detections file that names the cameras. Images of one name, but for that of the camera in it, are of one
    instant, as are the frames of one number of a video each.
    Raises InvalidInput for other inputs, for two images of a camera at one instant and for units that differ.
    """
    given = _by_camera(inputs, list(rig.cameras))
    found = {name: seen_by(rig.cameras[name], name, file, paths, looking, progress) for name, paths in given.items()}
    fitted = {**rig.cameras, **{name: camera for name, (camera, _) in found.items()}}
    seen = {name: each for name, (_, each) in found.items()}
    units = {each.unit for each in seen.values()}
    if len(units) > 1:
        raise InvalidInput("one camera's board has a size and another's has none; give the same --board to all")
    single = all(len({sight.image for sight in _sights(each)}) == 1 for each in seen.values())
    observations = [_by_instant(name, each, given[name], single) for name, each in seen.items()]
    together = joined([observation for each in observations for observation in each])
    if len(seen) > 1 and together and not any(len(each.views) > 1 for each in together):
        alone = f"no two cameras saw an object at one instant, such as {together[0].sight}"
        progress.warn(f"{alone}; images of one instant have one name but for that of the camera")
    return replace(rig, cameras=fitted), Seen(
        together,
        units.pop(),
        nothing={sight: reason for each in seen.values() for sight, reason in each.nothing.items()},
        refused={sight: error for each in seen.values() for sight, error in each.refused.items()},
        notes=tuple(dict.fromkeys(note for each in seen.values() for note in each.notes)),
        failed=tuple(line for each in seen.values() for line in each.failed),
    )


def joined(observations: Iterable[Observation]) -> tuple[Observation, ...]:
    """Return one observation for each sight: what the cameras saw under that name."""
    instants: dict[Sight, list[Observation]] = {}
    for observation in observations:
        instants.setdefault(observation.sight, []).append(observation)
    return tuple(
        Observation(
            sight,
            tuple(view for part in parts for view in part.views),
            tuple(ids for part in parts for ids in part.ids),
        )
        for sight, parts in instants.items()
    )


def _by_camera(inputs: tuple[str, ...], names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the inputs of every camera."""
    if len(inputs) == 1 and Path(inputs[0]).suffix.lower() in DETECTION_SUFFIXES and "=" not in inputs[0]:
        return dict.fromkeys(names, inputs)
    found: dict[str, tuple[str, ...]] = {}
    for text in inputs:
        name, mark, path = text.partition("=")
        if not (mark and path):
            raise InvalidInput(f"is of which camera? {SYNTAX}", where=text)
        if name not in names:
            raise InvalidInput(f"no camera {name!r} in the rig{did_you_mean(name, names)}", where=text)
        found[name] = (*found.get(name, ()), path)
    return found


def _sights(seen: Seen) -> list[Sight]:
    return [*(observation.sight for observation in seen.observations), *seen.nothing, *seen.refused]


def _by_instant(camera: str, seen: Seen, inputs: tuple[str, ...], single: bool) -> list[Observation]:
    """Return what a camera saw by the name of the instant; single: there is one image of every camera."""
    videos = [Path(text).stem for text in inputs if Path(text).suffix.lower() in VIDEO_SUFFIXES]
    found: dict[Sight, Observation] = {}
    for observation in seen.observations:
        instant = "instant" if single else _instant(Path(observation.sight.image).name, camera, videos)
        sight = observation.sight._replace(image=instant)
        if sight in found:
            both = f"{found[sight].views[0].image} and {observation.sight.image}"
            raise InvalidInput(f"{both} are two images of camera {camera!r} at one instant, {instant!r}; rename one")
        views = tuple(replace(view, camera=camera) for view in observation.views)
        found[sight] = replace(observation, sight=sight, views=views)
    return list(found.values())


def _instant(name: str, camera: str, videos: Sequence[str]) -> str:
    """Return the name of an image without the camera's, or the number of a frame of a video."""
    for stem in videos:
        if re.fullmatch(rf"{re.escape(stem)}_\d+", name):
            return name.removeprefix(f"{stem}_")
    end = "(?![A-Za-z])" if camera[-1].isalpha() else "(?![A-Za-z0-9])"  # left01 is of left, cam01 not of cam0
    bare = re.sub(rf"(?<![A-Za-z]){re.escape(camera)}{end}[_\-.]?", "", name)
    return bare if Path(bare).stem.strip("._-") else name
