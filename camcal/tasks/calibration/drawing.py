"""Remapping of images and video frames, in parallel."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from camcal.dataclass import dataclass, field, replace
from camcal.errors import CamcalError, InvalidInput
from camcal.images.files import load, save
from camcal.images.image import Image, Scratch
from camcal.images.remap import Maps
from camcal.images.video import frames
from camcal.progress import Outcome, Progress
from camcal.run import fingerprint
from camcal.run.options import BatchOptions
from camcal.run.resume import Items, resumable


@dataclass(frozen=True)
class Drawn:
    """An image written; frame: its number in the video it comes from, from 0, None for an image."""

    output: Path
    orientation: int
    frame: int | None = None


class Sources(NamedTuple):
    """Images and videos of one camera with the files they go to; numbers of frames go before the suffix."""

    images: Mapping[Path, Path]
    videos: Mapping[Path, Path]


class _Item(NamedTuple):
    """An image to draw: of a file, or a frame of a video with its number, or the error that ended the video.

    sha256: of the video.
    """

    source: Path
    camera: str
    output: Path
    frame: int | None = None
    image: Image | CamcalError | None = None
    sha256: str = ""

    @property
    def outputs(self) -> tuple[Path]:
        """All files that are written."""
        return (self.output,)


@dataclass(frozen=True, eq=False)
class Drawing:
    """What all images share.

    maps: by the names of cameras. border: see `Maps.apply`. quality: of JPEG. size_advice: what to do about another
    size.
    """

    maps: Mapping[str, Maps]
    border: tuple[float, ...] = (0.0,)
    quality: int = 95
    size_advice: str = ""
    spare: deque[Scratch] = field(default_factory=deque)  # of threads that have finished an image

    def outcomes(
        self, sources: Mapping[str, Sources], jobs: int | None, batch: BatchOptions, progress: Progress
    ) -> Iterator[tuple[str, Outcome[Path, Drawn]]]:
        """Yield what became of every image and every frame, each with the name of its camera; frames are not kept."""
        items: Iterable[_Item] = [
            _Item(path, camera, output) for camera, own in sources.items() for path, output in own.images.items()
        ]
        videos = [(camera, *video) for camera, own in sources.items() for video in own.videos.items()]
        if videos:
            items = chain(items, *(self._frames(*video) for video in videos))
        made: Items[_Item, Drawn] = Items(self._settings, self._inputs, attrgetter("outputs"), Drawn)
        for outcome in resumable(self._draw, items, made, jobs=jobs, batch=batch, what="images", progress=progress):
            yield outcome.item.camera, outcome.of(outcome.item.source)

    @cached_property
    def _settings(self) -> str:
        return fingerprint.of_data([fingerprint.versions(), list(self.border), self.quality])

    @cached_property
    def _maps_sha256(self) -> Mapping[str, str]:
        """The hashes of the maps by the names of cameras."""
        return {camera: _sha256(maps) for camera, maps in self.maps.items()}

    def _inputs(self, item: _Item) -> list[Path | str]:
        """Return what a picture is made from: an image, or a video, hashed once, and a frame's number; and maps."""
        source = [item.source] if item.image is None else [item.sha256, str(item.frame)]
        return [*source, self._maps_sha256[item.camera]]

    def _frames(self, camera: str, source: Path, output: Path) -> Iterator[_Item]:
        try:
            sha256 = fingerprint.of_source(source)
            for number, image in enumerate(frames(source)):
                self._check_size(camera, source, image)
                yield _Item(source, camera, output.with_stem(f"{output.stem}_{number:06d}"), number, image, sha256)
        except CamcalError as error:
            yield _Item(source, camera, output, None, error)

    def _draw(self, item: _Item) -> Drawn:
        """Return what was written of an item; raises CamcalError if it cannot be read, drawn or written."""
        if isinstance(item.image, CamcalError):
            raise item.image
        scratch = self._take_scratch()
        try:
            image = item.image or load(item.source, scratch)
            self._check_size(item.camera, item.source, image)
            view = self.maps[item.camera].apply(image.pixels, self.border, scratch)
            save(item.output, replace(image, pixels=view), quality=self.quality)
        finally:
            self.spare.append(scratch)
        return Drawn(item.output, image.orientation, item.frame)

    def _take_scratch(self) -> Scratch:
        with suppress(IndexError):
            return self.spare.pop()
        return Scratch()

    def _check_size(self, camera: str, source: Path, image: Image) -> None:
        size = self.maps[camera].source_size
        if image.size != size:
            found, wanted = ("{}x{}".format(*each) for each in (image.size, size))
            advice = self.size_advice if same_shape(image.size, size) else ""
            raise InvalidInput(f"is {found}, the camera {wanted}{advice}", where=str(source))


def _sha256(maps: Maps) -> str:
    every = [maps, *(maps.aligned[channel] for channel in sorted(maps.aligned))]
    arrays = [fingerprint.of_array(array) for each in every for array in (each.x, each.y)]
    return fingerprint.of_data([maps.interpolation, maps.source_size, sorted(maps.aligned), arrays])


def same_shape(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether one size is the other resized, give or take the pixel that rounding takes."""
    return abs(one[0] * other[1] - one[1] * other[0]) <= max(*one, *other)


def require_success(outcomes: Sequence[Outcome[Path, Drawn]]) -> None:
    """Raise the first error if there is nothing but errors."""
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    if errors and len(errors) == len(outcomes):
        more = f" ({len(errors)} images failed, none written)" if len(errors) > 1 else ""
        raise type(errors[0])(f"{errors[0].message}{more}", where=errors[0].where)
