"""Pictures of what was found in images and frames of videos, as many at a time as there are cores."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from camcal.arrays import Array
from camcal.images.save import save
from camcal.progress import Progress, values_of
from camcal.raw.options import Reading
from camcal.raw.photograph import read_photograph
from camcal.report.overlays import corner_overlay
from camcal.run.fanout import fan_out
from camcal.run.paths import record_outputs, refuse_collisions, refuse_overwriting
from camcal.targets.detection import Detection
from camcal.tasks.calibration.video_frames import Film

SUFFIX = "_corners.png"


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
