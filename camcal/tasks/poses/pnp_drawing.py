"""Pictures of poses over the images they come from, as many at a time as there are cores."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import CamcalError
from camcal.images.load import gray_8bit
from camcal.images.save import save
from camcal.images.video import frame_name, frames
from camcal.progress import Progress, values_of
from camcal.report.overlays import Posed, overlay
from camcal.run.fanout import fan_out
from camcal.run.paths import IMAGE_SUFFIXES, VIDEO_SUFFIXES, record_outputs, refuse_collisions, refuse_overwriting
from camcal.tasks.calibration.photographs import read_photograph

_SUFFIX = "_pose.png"
_BLANK = 110  # gray level where the image itself is not there


@dataclass(frozen=True, eq=False)
class Sheet:
    """A picture to be made: the name of the image as its views have it, and the objects in it."""

    image: str
    output: Path
    objects: tuple[Posed, ...]


@dataclass(frozen=True, eq=False)
class _Work:
    sheet: Sheet
    source: Path | None
    gray: Array | None = None  # of a frame of a video


def videos_in(paths: Sequence[Path]) -> list[Path]:
    """Return the videos among files and in folders."""
    inside = [each for path in paths for each in (sorted(path.iterdir()) if path.is_dir() else [path])]
    return [path for path in inside if path.suffix.lower() in VIDEO_SUFFIXES]


def sheets(objects: Mapping[tuple[str, str | None], Sequence[Posed]], folder: Path) -> list[Sheet]:
    """Return one sheet for each image (its name, and its camera in a rig) with all objects in it.

    Raises InvalidInput if two images would have one picture, or a picture the place of an image.
    """
    names = {key: f"{key[1]}_{Path(key[0]).stem}" if key[1] else Path(key[0]).stem for key in objects}
    if len(set(names.values())) < len(names):  # of several folders
        names = {key: f"{Path(key[0]).parent.name}_{name}" for key, name in names.items()}
    outputs = {key: folder / f"{name}{_SUFFIX}" for key, name in names.items()}
    refuse_collisions({Path(image): outputs[image, camera] for image, camera in objects})
    refuse_overwriting(outputs.values(), [Path(image) for image, _ in objects])
    return [Sheet(key[0], outputs[key], tuple(posed)) for key, posed in objects.items()]


def draw(
    pages: Sequence[Sheet],
    videos: Sequence[Path],
    folders: Sequence[Path],
    jobs: int | None,
    progress: Progress,
) -> tuple[Path, ...]:
    """Return the pictures that were written, one for each image.

    videos: whose frames may be among the images. folders: in which other images are looked for by their names; what is
    nowhere, or has another size than the camera, is drawn on gray. Raises FileError if a picture cannot be written.
    """
    written = values_of(fan_out(_draw, _work(pages, videos, folders), jobs=jobs, what="drawing", progress=progress))
    for folder in {path.parent for path in written}:
        record_outputs(folder, [path.name for path in written if path.parent == folder])
    return tuple(written)


def _work(pages: Sequence[Sheet], videos: Sequence[Path], folders: Sequence[Path]) -> Iterator[_Work]:
    waiting = {page.image: page for page in pages}
    for video in videos:
        try:
            for number, image in enumerate(frames(video)):
                page = waiting.pop(frame_name(video, number), None)
                if page is not None:
                    yield _Work(page, None, gray_8bit(image.pixels))
        except CamcalError:  # it is among those that failed
            continue
    for page in pages:
        if page.image in waiting:
            places = [Path(page.image), *(folder / page.image for folder in folders)]
            yield _Work(page, next((place for place in places if _may_be_image(place)), None))


def _may_be_image(path: Path) -> bool:
    """Tell whether a file is there that may be an image: points that name no image have the name of their own file."""
    return path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()


def _draw(work: _Work) -> Path:
    width, height = work.sheet.objects[0].camera.image_size
    gray = work.gray
    if gray is None and work.source is not None:
        gray = read_photograph(work.source).gray
    if gray is None or gray.shape != (height, width):
        gray = np.full((height, width), _BLANK, np.uint8)
    save(work.sheet.output, overlay(gray, work.sheet.objects))
    return work.sheet.output
