"""Drawing images and the frames of videos, through maps or with what was found in them, on all cores there are."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from camcal.arrays import Array
from camcal.errors import CamcalError, InvalidInput
from camcal.images.image import Image, Scratch
from camcal.images.load import load
from camcal.images.remap import Maps
from camcal.images.save import save
from camcal.images.video import frames
from camcal.progress import Outcome, Progress, values_of
from camcal.raw.options import Reading
from camcal.raw.photograph import read_photograph
from camcal.report.overlays import corner_overlay
from camcal.run.fanout import fan_out
from camcal.run.paths import record_outputs, refuse_collisions, refuse_overwriting
from camcal.targets.detection import Detection
from camcal.tasks.calibration.video_frames import Film

SUFFIX = "_corners.png"


@dataclass(frozen=True)
class Drawn:
    """An image written; frame: its number in the video it comes from, from 0, None for an image."""

    output: Path
    orientation: int
    frame: int | None = None


class _Item(NamedTuple):
    """An image to draw: of a file, or a frame of a video with its number, or the error that ended the video."""

    source: Path
    output: Path
    frame: int | None = None
    image: Image | CamcalError | None = None


@dataclass(frozen=True, eq=False)
class Drawing:
    """What all images share. border: see `Maps.apply`. quality: of JPEG. size_advice: what to do about another size."""

    maps: Maps
    border: tuple[float, ...] = (0.0,)
    quality: int = 95
    size_advice: str = ""
    spare: deque[Scratch] = field(default_factory=deque)  # of threads that have finished an image

    def images(
        self, outputs: Mapping[Path, Path], jobs: int | None, progress: Progress
    ) -> Iterator[Outcome[Path, Drawn]]:
        """Yield what became of every image: its source and the file it goes to."""
        return self._run("images", [_Item(*pair) for pair in outputs.items()], jobs, progress)

    def video(self, source: Path, output: Path, jobs: int | None, progress: Progress) -> Iterator[Outcome[Path, Drawn]]:
        """Yield what became of every frame; output: its number goes before the suffix. Frames are not kept."""
        return self._run(source.name, self._frames(source, output), jobs, progress)

    def _run(
        self, what: str, items: Iterable[_Item], jobs: int | None, progress: Progress
    ) -> Iterator[Outcome[Path, Drawn]]:
        for outcome in fan_out(self._draw, items, jobs=jobs, what=what, progress=progress):
            yield Outcome(outcome.item.source, outcome.value, outcome.error)

    def _frames(self, source: Path, output: Path) -> Iterator[_Item]:
        try:
            for number, image in enumerate(frames(source)):
                self._check_size(source, image)
                yield _Item(source, output.with_stem(f"{output.stem}_{number:06d}"), number, image)
        except CamcalError as error:
            yield _Item(source, output, None, error)

    def _draw(self, item: _Item) -> Drawn:
        """Return what was written of an item; raises CamcalError if it cannot be read, drawn or written."""
        if isinstance(item.image, CamcalError):
            raise item.image
        scratch = self._take_scratch()
        try:
            image = item.image or load(item.source, scratch)
            self._check_size(item.source, image)
            view = self.maps.apply(image.pixels, self.border, scratch)
            save(item.output, replace(image, pixels=view), quality=self.quality)
        finally:
            self.spare.append(scratch)
        return Drawn(item.output, image.orientation, item.frame)

    def _take_scratch(self) -> Scratch:
        with suppress(IndexError):
            return self.spare.pop()
        return Scratch()

    def _check_size(self, source: Path, image: Image) -> None:
        if image.size != self.maps.source_size:
            found, wanted = ("{}x{}".format(*size) for size in (image.size, self.maps.source_size))
            advice = self.size_advice if same_shape(image.size, self.maps.source_size) else ""
            raise InvalidInput(f"is {found}, the camera {wanted}{advice}", where=str(source))


def same_shape(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether one size is the other resized, give or take the pixel that rounding takes."""
    return abs(one[0] * other[1] - one[1] * other[0]) <= max(*one, *other)


def require_success(outcomes: Sequence[Outcome[Path, Drawn]]) -> None:
    """Raise the first error if there is nothing but errors."""
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    if errors and len(errors) == len(outcomes):
        more = f" ({len(errors)} images failed, none is written)" if len(errors) > 1 else ""
        raise type(errors[0])(f"{errors[0].message}{more}", where=errors[0].where)


@dataclass(frozen=True, eq=False)
class _Sheet:
    """A picture to be made of a view; gray: of a frame of a video, None for an image that is to be read."""

    view: Detection
    output: Path
    gray: Array | None = None


def pictures(images: Sequence[str], inputs: Sequence[Path], folder: Path) -> dict[str, Path]:
    """Return the file in a folder for each image, by its name as the views have it.

    Raises InvalidInput if two images would have one picture, or a picture the place of an input.
    """
    stems = {image: Path(image).stem for image in images}
    if len(set(stems.values())) < len(stems):  # of several folders
        stems = {image: f"{Path(image).parent.name}_{stem}" for image, stem in stems.items()}
    outputs = {image: folder / f"{stem}{SUFFIX}" for image, stem in stems.items()}
    refuse_collisions({Path(image): output for image, output in outputs.items()})
    refuse_overwriting(outputs.values(), inputs)
    return outputs


def draw(
    views: Sequence[Detection],
    outputs: Mapping[str, Path],
    films: Sequence[Film],
    reading: Reading,
    jobs: int | None,
    progress: Progress,
) -> tuple[Path, ...]:
    """Return the pictures that were written, one for each view; raises FileError if one cannot be."""
    sheets = _sheets(views, outputs, films)
    written = values_of(fan_out(partial(_draw, reading=reading), sheets, jobs=jobs, what="drawing", progress=progress))
    for folder in {path.parent for path in written}:
        record_outputs(folder, [path.name for path in written if path.parent == folder])
    return tuple(written)


def _sheets(views: Sequence[Detection], outputs: Mapping[str, Path], films: Sequence[Film]) -> Iterator[_Sheet]:
    """Yield what is to be drawn: images first, then the frames of one film after another."""
    names = frozenset(name for film in films for name in film.names)
    filmed = {view.image: view for view in views if view.image in names}
    for view in views:
        if view.image not in filmed:
            yield _Sheet(view, outputs[view.image])
    for film in films:
        for frame in film.only(filmed).frames():
            yield _Sheet(filmed[frame.name], outputs[frame.name], frame.image.pixels)


def _draw(sheet: _Sheet, reading: Reading) -> Path:
    gray = sheet.gray if sheet.gray is not None else read_photograph(Path(sheet.view.image), reading).gray
    save(sheet.output, corner_overlay(gray, sheet.view))
    return sheet.output
